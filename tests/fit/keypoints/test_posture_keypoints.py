"""Points in space read as a posture: exact for our own, free of size and bone lengths, robust by finger."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import PosedHands, Stage
from torchhand.fit.keypoints import KeypointSettings, PictureKeypoints, PostureKeypoints, place_hand
from torchhand.fit.keypoints.posture import _LASTING, _STD
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import FINGERS, JOINT_DOFS, HandKinematics, HandPose, Side, named_pose_space, posture
from torchhand.hand.limits import clamp_to_limits

SPACE = named_pose_space("dof26")
KINEMATICS = load_hand_model().kinematics(dtype=torch.float64)
SHAPE = KINEMATICS.default_shape
CAMERA = assumed_camera(640, 480, horizontal_fov_deg=50.0)
FINE = Stage(gross_m=0.004)


def _hand(seed: int, name: str = "open", *, kinematics: HandKinematics = KINEMATICS) -> HandPose:
    generator = torch.Generator().manual_seed(seed)
    free = SPACE.free(posture(name, dtype=torch.float64).double())
    free = free + 0.1 * torch.randn(SPACE.size, generator=generator, dtype=torch.float64)
    dofs = clamp_to_limits(SPACE.dof(free), kinematics.skeleton)[None]
    dofs[:, :6] = torch.tensor((0.02, 0.05, 0.5, 0.0, 0.0, 0.0), dtype=torch.float64)
    turn = rotation_from_vector(0.6 * torch.randn(3, generator=generator, dtype=torch.float64))
    return HandPose(dofs=dofs, reference=turn[None])


def _points(pose: HandPose, shape: Tensor = SHAPE, kinematics: HandKinematics = KINEMATICS) -> Tensor:
    return kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints


def _read(points: Tensor, kinematics: HandKinematics = KINEMATICS) -> PostureKeypoints:
    return PostureKeypoints.of_points(points, kinematics, SHAPE, KeypointSettings())


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", ["open", "fist", "point"])
def test_our_own_points_give_our_own_angles(side: Side, name: str) -> None:
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    truth = _hand(1, name, kinematics=kinematics)
    seen = _read(_points(truth, kinematics=kinematics), kinematics)
    told = seen.precision[0] > 0
    assert int(told.sum()) >= 15
    away = (seen.angles - truth.dofs[:, 6:])[0].abs()
    assert float((away * seen.precision[0].sqrt()).max()) < 1.0  # the palm's own bend and twists are not read
    ends = [i for i, n in enumerate(JOINT_DOFS) if n.endswith(("_pip_fe", "_dip_fe"))]
    assert float(away[ends].max()) < 0.02


def test_size_place_and_bone_lengths_tell_nothing() -> None:
    """Flexions of fingers with other lengths, in another unit, elsewhere and turned."""
    truth, longer = _hand(2), SHAPE.clone()
    for name in ("index_middle", "ring_proximal", "little_distal"):
        longer[KINEMATICS.shape_space.names.index(name)] *= 1.15
    turn = rotation_from_vector(torch.tensor((0.4, -1.0, 0.3), dtype=torch.float64))
    moved = 3.0 * _points(truth, longer) @ turn.T + 0.7
    flexions = [i for i, n in enumerate(JOINT_DOFS) if n.endswith(("_pip_fe", "_dip_fe"))]
    away = (_read(moved).angles - _read(_points(truth)).angles)[0, flexions]
    assert float(away.abs().max()) < 0.01


@pytest.mark.parametrize("finger", range(1, 5))
def test_a_missing_tip_leaves_its_end_joint_open_and_nothing_else(finger: int) -> None:
    points = _points(_hand(3))
    points[:, 4 + 4 * finger] = torch.nan
    lost = (_read(_points(_hand(3))).precision > 0) & (_read(points).precision == 0)
    assert [JOINT_DOFS[i] for i in lost[0].nonzero()[:, 0]] == [f"{FINGERS[finger]}_dip_fe"]


def test_default_proportions_are_read_as_any_others() -> None:
    points, settings = _points(_hand(2, "fist")), KeypointSettings()
    known, other = (
        PostureKeypoints.of_points(points, KINEMATICS, shape, settings)
        for shape in (KINEMATICS.default_shape, KINEMATICS.default_shape.clone())
    )
    torch.testing.assert_close(known.angles, other.angles, rtol=0, atol=1e-12)
    torch.testing.assert_close(known.pose.reference, other.pose.reference, rtol=0, atol=1e-12)


def test_too_few_points_tell_nothing() -> None:
    points = torch.full((1, 21, 3), torch.nan, dtype=torch.float64)
    points[:, :4] = torch.rand(1, 4, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    assert _read(points).is_empty


def test_a_finger_that_is_wrong_counts_little_and_costs_what_the_t_distribution_says() -> None:
    truth = _hand(4)
    seen = _read(_points(truth))
    hand = HandPose(dofs=truth.dofs.clone(), reference=truth.reference)
    hand.dofs[0, 6 + JOINT_DOFS.index("ring_pip_fe")] += 1.2
    posed = PosedHands(pose=hand, shape=SHAPE)
    factor = seen.associate(posed, FINE)
    ring, index = (JOINT_DOFS.index(name) for name in ("ring_pip_fe", "index_pip_fe"))
    assert float(factor.trust[0, ring]) < 0.5 * float(factor.trust[0, index])
    deviation, count = seen.deviation(hand.dofs[:, 6:])[0], (seen.precision[0].unflatten(-1, (5, 6)) > 0).sum(-1)
    expected = 0.5 * ((4 + count) * (1 + count * deviation.square() / 4).log()).sum()
    assert float(factor.equations(posed).cost) == pytest.approx(float(expected), rel=1e-9)


def _cameras(count: int) -> list[Camera]:
    """About the hand, which is half a metre before the first."""
    found = []
    for i in range(count):
        turn = rotation_from_vector(torch.tensor((0.0, 0.7 * i, 0.0), dtype=torch.float64))
        middle = torch.tensor((0.0, 0.0, 0.5), dtype=torch.float64)
        found.append(
            Camera(
                intrinsics=CAMERA.intrinsics.double(),
                rotation=turn,
                translation=middle - turn @ middle,
                distortion=torch.zeros(0, dtype=torch.float64),
                width=640,
                height=480,
                name=str(i),
            )
        )
    return found


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("name", ["open", "fist"])
def test_a_hand_is_placed_by_its_points_alone(count: int, name: str) -> None:
    """Three pixels of noise, one missing point and a wild one in every view; no start, no prediction."""
    truth, generator = _hand(5, name), torch.Generator().manual_seed(2)
    points = _points(truth)
    pictures, postures = [], []
    for view, camera in enumerate(_cameras(count)):
        noise = 3.0 * torch.randn(1, 21, 2, generator=generator, dtype=torch.float64)
        seen = camera.project(points) + noise
        seen[:, 3], seen[:, 16] = torch.nan, seen[:, 16] + 80.0
        pictures.append(
            PictureKeypoints(
                points_px=seen, kinematics=KINEMATICS, camera=camera, settings=KeypointSettings(), view=view
            )
        )
        in_camera = camera.cam_from_world(points)
        postures.append(
            PostureKeypoints.of_points(
                in_camera - in_camera.mean(1, keepdim=True),
                KINEMATICS,
                SHAPE,
                KeypointSettings(),
                world_from_points=camera.rotation.mT,
                view=view,
            )
        )
    found = place_hand(pictures, postures, KINEMATICS, SHAPE)
    assert found is not None
    off = (_points(found.pose.reshape(1)) - points)[0].norm(dim=-1)
    assert float(off.mean()) < (0.012 if count == 1 else 0.005)


def test_without_points_in_space_the_place_is_found_and_the_posture_stays_natural() -> None:
    truth = _hand(6)
    picture = PictureKeypoints(
        points_px=CAMERA.project(_points(truth)), kinematics=KINEMATICS, camera=CAMERA, settings=KeypointSettings()
    )
    found = place_hand([picture], [], KINEMATICS, SHAPE)
    assert found is not None
    off = (CAMERA.project(_points(found.pose.reshape(1))) - picture.points_px)[0].norm(dim=-1)
    assert float(off.mean()) < 10.0  # px


def test_no_points_place_no_hand() -> None:
    nothing = torch.full((1, 21, 2), torch.nan, dtype=torch.float64)
    picture = PictureKeypoints(points_px=nothing, kinematics=KINEMATICS, camera=CAMERA, settings=KeypointSettings())
    assert place_hand([picture], [], KINEMATICS, SHAPE) is None


RECORDINGS = (
    "real/joints3d_stills",
    *(f"synthetic/{n}" for n in ("rom_back", "rom_side", "rom_palm", "free", "flexion")),
)


@pytest.fixture(scope="module")
def errors(data_dir: Path) -> list[Tensor]:
    """Of the angles that a detector's points have, recording by recording, radians."""
    found = []
    for name in RECORDINGS:
        truth, seen = np.load(data_dir / name / "truth.npz"), np.load(data_dir / name / "mediapipe.npz")
        is_left = (seen["label"] == "Right").mean() > 0.5
        kinematics = load_hand_model().kinematics("left" if is_left else "right", dtype=torch.float64)
        known = np.isfinite(seen["world"]).all((1, 2))
        read, true = (
            _read(torch.from_numpy(points[known]).double(), kinematics).angles
            for points in (seen["world"], truth["keypoints3d"])
        )
        found.append(read - true)
    return found


@pytest.mark.parametrize("dof", list(_STD))
def test_the_spread_of_angles_is_that_of_known_hands(dof: str, errors: list[Tensor]) -> None:
    """The table beside the code, within two fifths of the median over the recordings."""
    spreads = [float(one[:, JOINT_DOFS.index(dof)].square().mean().sqrt()) for one in errors]
    assert 0.6 < _STD[dof] / float(np.median(spreads)) < 1.67


def test_errors_last_as_long_as_those_of_known_hands(errors: list[Tensor]) -> None:
    """The table's correlation with the frame before; photographs, the first of these, have none that counts."""
    for one in errors[1:]:
        away = one - one.mean(0)
        told = away[:, [JOINT_DOFS.index(name) for name in _STD]]
        correlation = (told[1:] * told[:-1]).sum() / (0.5 * (told[1:].square() + told[:-1].square())).sum()
        assert float(correlation) > _LASTING


def test_a_filter_is_told_less_by_every_frame_than_one_picture_tells() -> None:
    """Five readings whose errors are correlated by what the table says, as one: by drawing them."""
    truth = _hand(3)
    seen = _read(_points(truth))
    factor = seen.associate(PosedHands(pose=truth, shape=SHAPE), FINE)
    _, variance, is_known = factor.measurement()
    ratio = (variance * seen.precision[0])[is_known]
    generator = torch.Generator().manual_seed(0)
    errors = [torch.randn(100_000, generator=generator)]
    for _ in range(4):
        fresh = torch.randn(100_000, generator=generator)
        errors.append(_LASTING * errors[-1] + (1 - _LASTING**2) ** 0.5 * fresh)
    drawn = 5 * float(torch.stack(errors).mean(0).var())
    torch.testing.assert_close(ratio, torch.full_like(ratio, drawn), rtol=0.03, atol=0)
