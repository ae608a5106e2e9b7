"""Motion scripts before a camera."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import DOFS, HandKinematics, posture
from torchhand.simulate.motion.motion import VIEWS, Motion, Staging, facing, scripted_motion
from torchhand.simulate.motion.population import sample_shape
from torchhand.simulate.motion.scripts import SCRIPTS

FRAMES = 150
CAMERA = assumed_camera(360, 288, horizontal_fov_deg=48.0)


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics("right", dtype=torch.float64)


def _motion(name: str, kinematics: HandKinematics, *, seed: int = 4, camera: Camera = CAMERA, **options) -> Motion:
    return scripted_motion(name, FRAMES, kinematics, camera, torch.Generator().manual_seed(seed), **options)


def _keypoints(motion: Motion, kinematics: HandKinematics, shape: Tensor | None = None) -> Tensor:
    return kinematics(motion.poses, shape, root_reference=motion.root_reference).keypoints


def _joint(motion: Motion, dof: str) -> Tensor:
    return torch.rad2deg(motion.poses[:, DOFS.index(dof)])


@pytest.mark.parametrize("name", SCRIPTS)
def test_angles_stay_inside_the_limits(name: str, kinematics: HandKinematics) -> None:
    for seed in range(5):
        joints = _motion(name, kinematics, seed=seed, staging=Staging(pace=3.0)).poses[:, 6:]
        assert (joints >= kinematics.skeleton.lower).all()
        assert (joints <= kinematics.skeleton.upper).all()


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_motion_starts_from_rest_in_its_posture(name: str, kinematics: HandKinematics) -> None:
    motion = _motion(name, kinematics)
    start = posture("point" if name == "planar_point" else "open", dtype=torch.float64)
    torch.testing.assert_close(motion.poses[0, 3:6], torch.zeros(3, dtype=torch.float64), rtol=0, atol=1e-12)
    torch.testing.assert_close(motion.poses[0, 6:], start[6:], rtol=0, atol=1e-12)
    steps = motion.poses.diff(dim=0).abs()
    assert steps[0, :3].max() < 0.0005
    assert steps[0, 3:].max() < math.radians(0.7)


@pytest.mark.parametrize("name", [name for name in SCRIPTS if name != "leave"])
@pytest.mark.parametrize("camera", [CAMERA, assumed_camera(240, 426)], ids=["landscape", "portrait"])
def test_the_hand_stays_in_the_picture_and_fills_it(name: str, camera: Camera, kinematics: HandKinematics) -> None:
    for seed in range(3):
        points = camera.project(_keypoints(_motion(name, kinematics, seed=seed, camera=camera), kinematics))
        inside = (points >= 0) & (points <= torch.tensor((camera.width - 1, camera.height - 1)))
        assert inside.all(-1).double().mean() > 0.97
        length = (points[0, 12] - points[0, 0]).norm() if name == "planar" else None
        if length is not None:
            assert 0.5 < max(length / camera.height, length / camera.width) < 0.65


def test_planar_motion_is_planar(kinematics: HandKinematics) -> None:
    motion = _motion("planar", kinematics)
    points = _keypoints(motion, kinematics)
    torch.testing.assert_close(points[..., 2], points[:1, :, 2].expand(FRAMES, 21), rtol=0, atol=1e-12)
    assert motion.poses[:, 3:5].abs().max() == 0
    travel_px = torch.stack([p.amax(0) - p.amin(0) for p in [CAMERA.project(points)[:, 9]]])
    assert travel_px.min() > 20
    assert torch.rad2deg(motion.poses[:, 5].max() - motion.poses[:, 5].min()) > 15
    # An image feature moves no further between frames than an edge search reaches.
    assert CAMERA.project(points).diff(dim=0).norm(dim=-1).max() < 8


def test_flexion_bends_one_finger_after_the_other_then_all(kinematics: HandKinematics) -> None:
    motion = _motion("flexion", kinematics)
    bends = torch.stack([_joint(motion, f"{f}_mcp_fe") for f in ("index", "middle", "ring", "little")], -1)
    for finger in range(4):
        middle = round((finger + 1.5) / 6 * (FRAMES - 1))
        assert bends[middle, finger] > 60
        others = [i for i in range(4) if i != finger]
        assert bends[middle, others].max() < 10
    assert bends[round(5.5 / 6 * (FRAMES - 1))].min() > 55
    assert bends[-1].max() < 1e-6


def test_abduction_closes_the_fingers(kinematics: HandKinematics) -> None:
    motion = _motion("abduction", kinematics)
    spread = _joint(motion, "index_mcp_aa") - _joint(motion, "middle_mcp_aa")
    assert spread[0] == pytest.approx(12.0)
    assert spread.min() < 4
    assert spread.max() <= 18
    assert _joint(motion, "index_pip_fe").abs().max() == 0


def test_free_turns_out_of_the_picture_plane_and_moves_in_depth(kinematics: HandKinematics) -> None:
    tilts, depths = [], []
    for seed in range(4):
        motion = _motion("free", kinematics, seed=seed)
        tilts.append(torch.rad2deg(motion.poses[:, 3:5].abs().max()))
        depths.append(motion.poses[:, 2].max() - motion.poses[:, 2].min())
    assert 20 < max(tilts) <= 35
    assert max(depths) > 0.04


def test_wave_goes_from_side_to_side(kinematics: HandKinematics) -> None:
    x = CAMERA.project(_keypoints(_motion("wave", kinematics), kinematics))[:, 9, 0]
    assert x.min() < 0.35 * CAMERA.width
    assert x.max() > 0.65 * CAMERA.width
    depth = _motion("wave", kinematics).poses[:, 2]
    assert depth.max() - depth.min() > 0.02


def test_leave_leaves_and_comes_back(kinematics: HandKinematics) -> None:
    for seed in range(4):
        points = CAMERA.project(_keypoints(_motion("leave", kinematics, seed=seed), kinematics))
        inside = ((points >= 0) & (points <= torch.tensor((359, 287)))).all(-1)
        assert inside[: FRAMES // 4].all()
        assert inside[-FRAMES // 8 :].all()
        away = points[round(0.45 * FRAMES) : round(0.6 * FRAMES), :, 0]
        assert ((away < -20) | (away > 380)).all()


@pytest.mark.parametrize("name", SCRIPTS)
def test_the_seed_decides(name: str, kinematics: HandKinematics) -> None:
    torch.testing.assert_close(_motion(name, kinematics).poses, _motion(name, kinematics).poses, rtol=0, atol=0)
    assert (_motion(name, kinematics).poses - _motion(name, kinematics, seed=5).poses).abs().max() > 1e-3


def test_a_placed_camera_sees_the_same(kinematics: HandKinematics) -> None:
    rotation = rotation_from_vector(torch.tensor((0.4, -0.9, 0.3), dtype=torch.float64))
    placed = replace(CAMERA, rotation=rotation, translation=torch.tensor((0.1, -0.2, 0.3), dtype=torch.float64))
    expected = CAMERA.project(_keypoints(_motion("free", kinematics), kinematics))
    seen = placed.project(_keypoints(_motion("free", kinematics, camera=placed), kinematics))
    torch.testing.assert_close(seen, expected, rtol=0, atol=1e-8)


def test_an_orthographic_camera_sees_the_hand_in_its_middle(kinematics: HandKinematics) -> None:
    intrinsics = torch.tensor(((900.0, 0, 179.5), (0, 900.0, 143.5), (0, 0, 1)), dtype=torch.float64)
    camera = replace(CAMERA, kind="orthographic", intrinsics=intrinsics)
    points = camera.project(_keypoints(_motion("planar", kinematics, camera=camera), kinematics))
    assert (points[0].amin(0) > 10).all()
    assert (points[0].amax(0) < torch.tensor((350, 278))).all()


@pytest.mark.parametrize("side", ["left", "right"])
def test_views_show_the_side_they_name(side: str) -> None:
    kinematics = load_hand_model().kinematics("left" if side == "left" else "right", dtype=torch.float64)
    for view in VIEWS:
        assert float(torch.linalg.det(facing(view))) == pytest.approx(1.0)
        points = _keypoints(_motion("planar", kinematics, staging=Staging(view=view)), kinematics)[0]
        assert points[12, 1] < points[0, 1]  # fingers up
        # The thumb of a right hand seen from the back is at the left.
        thumb_is_left = points[4, 0] < points[20, 0]
        assert bool(thumb_is_left) == ((side == "right") == (view == "back"))
    bent = posture("fist", dtype=torch.float64).expand(1, 36)
    for view in VIEWS:  # bent fingers come out of the palm
        points = kinematics(bent, root_reference=facing(view)).keypoints[0]
        assert bool(points[8, 2] < points[5, 2]) == (view == "palm")


def test_another_persons_hand_fills_the_picture_alike(kinematics: HandKinematics) -> None:
    shape = kinematics.default_shape.clone()
    shape[:2] *= 1.2  # length and breadth: everything else is a share of these
    large = CAMERA.project(_keypoints(_motion("planar", kinematics, shape=shape), kinematics, shape))[0]
    usual = CAMERA.project(_keypoints(_motion("planar", kinematics), kinematics))[0]
    torch.testing.assert_close(large, usual, rtol=0, atol=1e-9)


def test_wrong_wishes_are_named(kinematics: HandKinematics) -> None:
    with pytest.raises(ValueError, match=r"motion: expected one of planar, .* got 'dance'"):
        _motion("dance", kinematics)
    with pytest.raises(ValueError, match="pace: expected 0 or more, got -1"):
        _motion("planar", kinematics, staging=Staging(pace=-1.0))
    with pytest.raises(ValueError, match="fps: expected a positive"):
        _motion("planar", kinematics, staging=Staging(fps=0.0))
    with pytest.raises(ValueError, match="frames: expected 1 or more, got 0"):
        scripted_motion("planar", 0, kinematics, CAMERA, torch.Generator())


def test_sampled_people_spread_as_the_shape_space_says(generator: torch.Generator) -> None:
    space = load_hand_model().shape_space
    shapes = sample_shape(space, generator, 2000)
    assert (shapes >= space.lower).all()
    assert (shapes <= space.upper).all()
    deviation = (shapes - space.default) / space.std
    assert deviation.mean(0).abs().max() < 0.15
    # Bounds cut the tails off, nowhere below two standard deviations.
    assert deviation.std(0).min() > 0.7
    assert deviation.std(0).max() < 1.1
    assert sample_shape(space, generator).shape == space.default.shape
    assert sample_shape(space, generator, 2, 3).shape == (2, 3, len(space.names))
    assert torch.equal(sample_shape(space, generator, spread=0.0), space.default)
    first, again = (sample_shape(space, torch.Generator().manual_seed(8), 3) for _ in range(2))
    assert torch.equal(first, again)
    with pytest.raises(ValueError, match="spread: expected 0 or more"):
        sample_shape(space, generator, spread=-1.0)
