"""Keypoints as factors: exact derivatives, invariance to what they cannot tell, missing points and outliers."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import Observation, PosedHands, Problem, Stage, solve
from torchhand.fit.keypoints.observation import KeypointSettings, PictureKeypoints, SpaceKeypoints
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import HandPose, named_pose_space, posture
from torchhand.hand.limits import clamp_to_limits

FINE = Stage(gross_m=0.004, rounds=3, iterations=10)
SPACE = named_pose_space("dof27")
KINEMATICS = load_hand_model().kinematics(dtype=torch.float64)
CAMERA = assumed_camera(640, 480, horizontal_fov_deg=50.0)


def _hands(count: int, seed: int, spread: float = 0.2) -> HandPose:
    generator = torch.Generator().manual_seed(seed)
    free = SPACE.free(posture("open").double())
    free = free + spread * torch.randn(count, SPACE.size, generator=generator, dtype=torch.float64)
    dofs = clamp_to_limits(SPACE.dof(free), KINEMATICS.skeleton)
    dofs[:, :3] = torch.tensor((0.02, 0.05, 0.5), dtype=torch.float64)
    dofs[:, 3:6] = 0
    reference = rotation_from_vector(0.5 * torch.randn(count, 3, generator=generator, dtype=torch.float64))
    return HandPose(dofs=dofs, reference=reference)


def _posed(pose: HandPose) -> PosedHands:
    return PosedHands(pose=pose, shape=KINEMATICS.default_shape)


def _keypoints(pose: HandPose) -> Tensor:
    return KINEMATICS(pose.dofs, root_reference=pose.reference).keypoints


def _observations(truth: HandPose) -> dict[str, Observation]:
    points, settings = _keypoints(truth), KeypointSettings()
    return {
        "picture": PictureKeypoints(
            points_px=CAMERA.project(points), kinematics=KINEMATICS, camera=CAMERA, settings=settings
        ),
        "space": SpaceKeypoints(points=points, kinematics=KINEMATICS, settings=settings),
    }


@pytest.mark.parametrize("kind", ["picture", "space"])
def test_the_gradient_is_that_of_the_cost(kind: str) -> None:
    observation, hands = _observations(_hands(3, 1))[kind], _hands(3, 2)
    factor = observation.associate(_posed(hands), FINE)
    found = factor.equations(_posed(hands))
    step = 1e-6
    for dof in range(36):
        moved = torch.zeros(36, dtype=torch.float64)
        moved[dof] = step
        costs = [
            factor.equations(_posed(HandPose(dofs=hands.dofs + sign * moved, reference=hands.reference))).cost
            for sign in (1, -1)
        ]
        numerical = (costs[0] - costs[1]) / (2 * step)
        scale = found.gradient.abs().amax(-1)
        assert bool(((found.gradient[:, dof] - numerical).abs() <= 1e-5 * scale + 1e-6).all()), dof


def test_points_in_space_tell_nothing_of_place_direction_and_size() -> None:
    truth, hands = _hands(1, 3), _hands(4, 4)
    turn = rotation_from_vector(torch.tensor((0.3, -1.0, 0.5), dtype=torch.float64))
    points = _keypoints(truth)
    moved = 1.7 * points @ turn.T + torch.tensor((0.3, 0.1, -0.2), dtype=torch.float64)
    costs = []
    for given in (points, moved):
        observation = SpaceKeypoints(points=given, kinematics=KINEMATICS, settings=KeypointSettings())
        found = observation.associate(_posed(hands), FINE).equations(_posed(hands))
        costs.append(found.cost)
        root = found.matrix[:, :6, :6].abs().amax((-2, -1))
        assert bool((root <= 1e-9 * found.matrix.abs().amax((-2, -1))).all())
    assert torch.allclose(costs[0], costs[1], rtol=1e-9, atol=0)


@pytest.mark.parametrize("missing", [(), (4,), (8, 12, 16, 20), tuple(range(5, 9))])
def test_both_together_recover_the_hand(missing: tuple[int, ...]) -> None:
    truth, starts = _hands(1, 5), _hands(6, 6, spread=0.1)
    own = _observations(truth)
    picture, space = own["picture"], own["space"]
    assert isinstance(picture, PictureKeypoints)
    assert isinstance(space, SpaceKeypoints)
    picture.points_px[:, list(missing)] = torch.nan
    starts = HandPose(dofs=starts.dofs, reference=truth.reference.expand(6, 3, 3))
    problem = Problem(
        space=SPACE, skeleton=KINEMATICS.skeleton, shape=KINEMATICS.default_shape, observations=(picture, space)
    )
    schedule = (Stage(gross_m=0.05, rounds=3, iterations=20), Stage(gross_m=0.004, rounds=3, iterations=20))
    found = solve(problem, starts, schedule)
    best = found.select(found.best)
    error = (_keypoints(best.pose) - _keypoints(truth)[0]).norm(dim=-1)
    assert float(error.max()) < 1e-4


def test_a_point_that_jumped_counts_for_next_to_nothing() -> None:
    truth = _hands(1, 7)
    own = _observations(truth)["picture"]
    assert isinstance(own, PictureKeypoints)
    own.points_px[0, 8] += torch.tensor((60.0, -40.0))
    factor = own.associate(_posed(truth), FINE)
    assert float(factor.trust[0, 8]) < 0.05 * float(factor.trust[0, 12])
    _, variance, is_known = factor.measurement()
    assert bool(is_known.all())
    assert float(variance[16]) > 20 * float(variance[24])


def test_no_points_are_an_empty_observation() -> None:
    nothing = torch.full((1, 21, 2), math.nan, dtype=torch.float64)
    assert PictureKeypoints(
        points_px=nothing, kinematics=KINEMATICS, camera=CAMERA, settings=KeypointSettings()
    ).is_empty
