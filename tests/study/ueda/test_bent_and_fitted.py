"""The study of Ueda et al. 2003: a bent finger found again, methods compared on equal problems, times of the stages."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.evaluate import flexion_deg
from torchhand.files import load_hand_model
from torchhand.fit.hull import HullTorqueSettings
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandPose, pose_space, posture
from torchhand.simulate import facing, named_rig
from torchhand.study.ueda.bent import BentFinger, converge, knuckle_deg, phalanx_turn_deg, turn_of
from torchhand.study.ueda.cases import fingers, root_at, subject
from torchhand.study.ueda.compare import Subject, fit_errors
from torchhand.study.ueda.methods import METHODS, FitProblem
from torchhand.study.ueda.stages import STAGES, stage_times
from torchhand.view import mesh_silhouette

INDEX = DOFS.index("index_mcp_fe")
MODEL = load_hand_model()
HAND = MODEL.hand(dtype=torch.float64)
REFERENCE = facing("palm")
SETTINGS = HullTorqueSettings(outside_fraction=0.0)


def flat(deg: float) -> Tensor:
    pose = posture("flat", dtype=torch.float64)
    pose[1] = 0.09
    pose[INDEX] = math.radians(deg)
    return pose


@pytest.fixture(scope="module")
def bent() -> BentFinger:
    """The index bent by 10° in the paper's frame of four cameras."""
    cameras = named_rig("frame")
    vertices = HAND(flat(10), root_reference=REFERENCE).vertices
    return BentFinger(
        cameras=cameras,
        masks=[mesh_silhouette(vertices, HAND.faces, camera, is_closed=True) for camera in cameras],
        root=root_at(cameras),
        hand=HAND,
        shape=HAND.kinematics.default_shape,
        space=pose_space("fingers", fingers()).about(flat(0)),
        start=HandPose.of(flat(0), REFERENCE),
        measure=knuckle_deg,
        truth_deg=10.0,
    )


@pytest.mark.parametrize(("level", "max_deg"), [(7, 1.0), (8, 0.5)])
def test_the_bent_index_is_found_again(bent: BentFinger, level: int, max_deg: float) -> None:
    found = converge(bent, level, SETTINGS)
    assert len(found.error_deg) == len(found.inside_fraction) == 21
    assert found.error_deg[0] == pytest.approx(10)
    assert found.error_deg[-1] <= max_deg
    assert found.within_fraction[-1] > found.within_fraction[0] > 0.5
    assert found.inside_fraction[0] < found.inside_fraction[-1]  # the paper's rate: of all octants that are not WHITE
    assert found.inside_fraction[-1] > 0.995
    assert found.milliseconds > 0


def test_another_makers_hand_is_evaluated_by_the_change(bent: BentFinger) -> None:
    """The start of another hand is off; what it settles to before does not count as a turn."""
    off = bent.start.dofs.clone()
    off[INDEX] = math.radians(4)
    straight = [
        mesh_silhouette(HAND(flat(0), root_reference=REFERENCE).vertices, HAND.faces, camera, is_closed=True)
        for camera in bent.cameras
    ]
    turn = turn_of(HAND.kinematics, bent.shape)
    case = replace(bent, start=HandPose.of(off, REFERENCE), measure=turn)
    by_start, by_change = (converge(replace(case, straight_masks=m), 7, SETTINGS) for m in (None, straight))
    assert by_start.error_deg[-1] == pytest.approx(4, abs=1)
    assert by_change.error_deg[-1] < 1.5
    assert by_start.error_deg[0] == by_change.error_deg[0] == 10


def test_angles_of_the_finger() -> None:
    poses = HandPose.of(torch.stack([flat(deg) for deg in (5.0, 35.0, 65.0)]), REFERENCE)
    assert torch.allclose(knuckle_deg(poses), torch.tensor((5.0, 35.0, 65.0), dtype=torch.float64))
    turn = turn_of(HAND.kinematics, HAND.kinematics.default_shape)(poses)
    assert torch.allclose(turn, torch.tensor((0.0, 30.0, 60.0), dtype=torch.float64), atol=1e-6)
    points = torch.randn(21, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    spin = rotation_from_vector(torch.tensor((0.0, 0.0, 0.3), dtype=torch.float64))
    points[6] = points[5] + torch.tensor((0.03, 0.04, 0.0), dtype=torch.float64)
    pair = torch.stack((points, 2 * points @ spin.T))
    assert float(phalanx_turn_deg(pair)[1]) == pytest.approx(math.degrees(0.3))


@pytest.fixture(scope="module")
def person() -> Subject:
    return subject(MODEL, named_rig("frame4"), 0, 3, noise_px=1.0, off=(4.0, 4.0))


def test_methods_on_one_problem(person: Subject) -> None:
    errors = fit_errors(person, 4, 7, METHODS)
    assert list(errors) == list(METHODS)
    frames = [
        person.hand.kinematics(hand.dofs, person.shape, root_reference=hand.reference).keypoints
        for hand in (person.guess, person.truth)
    ]
    distance = 1e3 * float((frames[0] - frames[1]).norm(dim=-1).mean())
    assert errors["guess"].joint_mm == pytest.approx(distance)
    flexion = [flexion_deg(points.numpy()) for points in frames]
    assert errors["guess"].flexion_deg == pytest.approx(float(np.abs(flexion[0] - flexion[1]).mean()))
    assert errors["LM, contours"].joint_mm < 2.5
    assert errors["LM, contours"].joint_mm < errors["torque"].joint_mm < errors["guess"].joint_mm


def test_each_method_is_given_the_views_that_count(person: Subject) -> None:
    seen: list[FitProblem] = []

    def looked(problem: FitProblem) -> HandPose:
        seen.append(problem)
        return person.truth

    errors = fit_errors(person, 2, 6, {"truth": looked})
    assert errors["truth"].joint_mm == 0
    [problem] = seen
    assert [camera.name for camera in problem.cameras] == ["front", "side"]
    assert len(problem.masks) == 2
    assert torch.equal(problem.guess.dofs, person.guess.dofs)
    inside, _ = problem.target.field.sample(problem.target.inner)
    assert float(inside.max()) < 0


def test_people_differ_and_are_seeded(person: Subject) -> None:
    same, other = (subject(MODEL, named_rig("frame4"), number, 3, noise_px=1.0, off=(4.0, 4.0)) for number in (0, 1))
    assert torch.equal(same.guess.dofs, person.guess.dofs)
    assert all(torch.equal(a, b) for a, b in zip(same.masks, person.masks, strict=True))
    assert not torch.equal(other.shape, person.shape)
    exact = subject(MODEL, named_rig("frame4"), 0, 3, noise_px=0.0, off=(0.0, 0.0))
    assert torch.allclose(exact.guess.dofs, exact.truth.dofs)
    assert torch.equal(exact.truth.dofs, person.truth.dofs)
    for mask in exact.masks:
        edge = torch.cat((mask[0], mask[-1], mask[:, 0], mask[:, -1]))
        assert 2000 < int(mask.sum()) < 100_000
        assert not bool(edge.any())


def test_stages_are_timed(bent: BentFinger) -> None:
    screen = torch.tensor((20, 50, 200), dtype=torch.uint8).expand(480, 640, 3).clone()
    times = stage_times(bent, [screen] * 4, 6, 1)
    assert list(times) == list(STAGES)
    assert min(times.values()) > 0
