"""Hands fitted to what detectors saw: points in pictures with covariances and in space, of one camera or several."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.files import load_cameras, load_hand_model
from torchhand.fit.keypoints import KeypointFitSettings, SeenKeypoints, fit_keypoints
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import DOFS, HandKinematics, centre_covariance, posture
from torchhand.hand.limits import clamp_to_limits

DOUBLE = torch.float64


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics("right", dtype=DOUBLE)


def _cameras(count: int) -> list[Camera]:
    """About a hand half a metre before the first."""
    one, found = assumed_camera(640, 480, horizontal_fov_deg=50.0), []
    for view in range(count):
        turn = rotation_from_vector(torch.tensor((0.0, 0.8 * view, 0.1 * view), dtype=DOUBLE))
        middle = torch.tensor((0.0, 0.0, 0.5), dtype=DOUBLE)
        found.append(replace(one, rotation=turn, translation=middle - turn @ middle, is_assumed=False))
    return found


def _truth(kinematics: HandKinematics, count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    poses = torch.stack([posture(("open", "point", "fist")[i % 3]) for i in range(count)]).to(DOUBLE)
    poses[:, 6:] += 0.15 * torch.rand(count, len(DOFS) - 6, generator=generator, dtype=DOUBLE)
    poses = clamp_to_limits(poses, kinematics.skeleton)
    poses[:, :3] = torch.tensor((0.02, 0.06, 0.5), dtype=DOUBLE)
    poses[:, 3:6] = 0.5 * torch.randn(count, 3, generator=generator, dtype=DOUBLE)
    return poses, kinematics(poses, kinematics.default_shape).keypoints


def _seen(points: Tensor, camera: Camera, generator: torch.Generator, px: float, m: float) -> SeenKeypoints:
    in_camera = camera.cam_from_world(points)
    noise_px = px * torch.randn(points[..., :2].shape, generator=generator, dtype=DOUBLE)
    noise_m = m * torch.randn(points.shape, generator=generator, dtype=DOUBLE)
    own = 1.3 * (in_camera - in_camera.mean(-2, keepdim=True)) + noise_m
    return SeenKeypoints(camera=camera, points_px=camera.project(points) + noise_px, points=own)


def _joint_error(found: Tensor, points: Tensor) -> float:
    """Mean distance relative to the wrist, metres."""
    return float(((found - found[:, :1]) - (points - points[:, :1])).norm(dim=-1).mean())


def test_both_kinds_together_beat_each_alone(kinematics: HandKinematics) -> None:
    _, points = _truth(kinematics, 9)
    camera, generator = _cameras(1)[0], torch.Generator().manual_seed(1)
    both = _seen(points, camera, generator, 4.0, 0.012)
    picture = fit_keypoints(kinematics, replace(both, points=None))
    assert both.points is not None
    space = fit_keypoints(kinematics, both.points / 1.3)
    together = fit_keypoints(kinematics, both)
    errors = [_joint_error(fit.keypoints, points) for fit in (together, picture, space)]
    assert errors[0] < 0.9 * min(errors[1:])


def test_several_cameras_tell_the_place(kinematics: HandKinematics) -> None:
    _, points = _truth(kinematics, 6)
    generator = torch.Generator().manual_seed(2)
    seen = [_seen(points, camera, generator, 2.0, 0.01) for camera in _cameras(3)]
    lost = seen[1].points_px.clone()
    lost[2] = torch.nan  # a frame that one camera did not see
    seen[1] = replace(seen[1], points_px=lost)
    several = fit_keypoints(kinematics, seen)
    assert several.status.tolist() == [0] * 6
    one = fit_keypoints(kinematics, seen[0])  # whose depth is open
    off = [float((fit.keypoints - points).norm(dim=-1).mean()) for fit in (several, one)]
    assert off[0] < 0.005
    assert off[0] < 0.5 * off[1]
    assert float(several.keypoints_covariance.diagonal(dim1=-2, dim2=-1).sum()) < float(
        one.keypoints_covariance.diagonal(dim1=-2, dim2=-1).sum()
    )


def test_a_covariance_says_which_way_a_point_may_be_off(kinematics: HandKinematics) -> None:
    """Points that are off by 30 px along x, and say so, spoil nothing; said to be off along y, they do."""
    _, points = _truth(kinematics, 3)
    camera = _cameras(1)[0]
    pixels = camera.project(points)
    for finger in (8, 12, 16):
        pixels[:, finger, 0] += 30.0
    errors = []
    for axis in (0, 1):
        cov = (1.5**2 * torch.eye(2, dtype=DOUBLE)).repeat(3, 21, 1, 1)
        cov[:, [8, 12, 16], axis, axis] = 40.0**2
        fit = fit_keypoints(kinematics, SeenKeypoints(camera=camera, points_px=pixels, cov_px=cov))
        errors.append(_joint_error(fit.keypoints, points))
    assert errors[0] < 0.7 * errors[1]


def test_round_covariances_are_standard_deviations(kinematics: HandKinematics) -> None:
    _, points = _truth(kinematics, 3)
    camera, generator = _cameras(1)[0], torch.Generator().manual_seed(3)
    seen = replace(_seen(points, camera, generator, 2.0, 0.0), points=None)
    cov = (2.0**2 * torch.eye(2, dtype=DOUBLE)).repeat(3, 21, 1, 1)
    cov[:, 5] = torch.nan  # not known: that of the settings
    settings = KeypointFitSettings(noise_px=2.0)
    plain = fit_keypoints(kinematics, seen, settings=settings)
    told = fit_keypoints(kinematics, replace(seen, cov_px=cov), settings=settings)
    torch.testing.assert_close(told.keypoints, plain.keypoints, rtol=0.0, atol=1e-6)
    torch.testing.assert_close(told.pose_covariance, plain.pose_covariance, rtol=1e-4, atol=1e-10)


def test_a_camera_per_frame_and_batches(kinematics: HandKinematics) -> None:
    _, points = _truth(kinematics, 4)
    camera, generator = _cameras(1)[0], torch.Generator().manual_seed(4)
    cameras = replace(
        camera,
        intrinsics=camera.intrinsics.expand(2, 2, 3, 3),
        rotation=camera.rotation.expand(2, 2, 3, 3),
        translation=camera.translation.expand(2, 2, 3),
        distortion=camera.distortion.expand(2, 2, -1),
    )
    seen = _seen(points, camera, generator, 1.0, 0.01)
    assert seen.points is not None
    whole = fit_keypoints(kinematics, seen)
    batched = SeenKeypoints(
        camera=cameras, points_px=seen.points_px.unflatten(0, (2, 2)), points=seen.points.unflatten(0, (2, 2))
    )
    fit = fit_keypoints(kinematics, batched)
    assert fit.pose.shape == (2, 2, 36)
    torch.testing.assert_close(fit.keypoints.flatten(0, 1), whole.keypoints, rtol=0.0, atol=1e-6)


def test_error_messages(kinematics: HandKinematics) -> None:
    camera, points = _cameras(1)[0], torch.zeros(2, 21, 2, dtype=DOUBLE)
    seen = SeenKeypoints(camera=camera, points_px=points)
    with pytest.raises(ValueError, match="at least one camera, got none"):
        fit_keypoints(kinematics, [])
    with pytest.raises(ValueError, match="expected none beside SeenKeypoints"):
        fit_keypoints(kinematics, seen, camera=camera)
    with pytest.raises(ValueError, match="expected the same frames for every camera"):
        fit_keypoints(kinematics, [seen, replace(seen, points_px=points[:1])])
    with pytest.raises(ValueError, match="confidence: expected 0 or more, got -1"):
        SeenKeypoints(camera=camera, points_px=points, confidence=-torch.ones(2, 21, dtype=DOUBLE))


@pytest.mark.parametrize("is_recording", [False, True])
def test_one_camera_leaves_the_size_as_open_as_people_are(kinematics: HandKinematics, is_recording: bool) -> None:
    """Whatever points in space and neighbouring frames say; leaps are judged by the frames around them."""
    poses, _ = _truth(kinematics, 1)
    poses = poses.repeat(24, 1)
    poses[:, :3] += 0.002 * torch.arange(24, dtype=DOUBLE)[:, None] * torch.tensor((1.0, 0.5, 0.3), dtype=DOUBLE)
    poses[12, DOFS.index("index_pip_fe")] += 1.2  # a leap
    points = kinematics(poses, kinematics.default_shape).keypoints
    seen = _seen(points, _cameras(1)[0], torch.Generator().manual_seed(4), 1.0, 0.005)
    fit = fit_keypoints(kinematics, seen, fit_shape=True, settings=KeypointFitSettings(is_recording=is_recording))
    space = kinematics.shape_space
    length = space.names.index("hand_length")
    assert 0.8 * float(space.std[length]) < float(fit.shape_std[length]) < 1.05 * float(space.std[length])
    depth_std = fit.keypoints_covariance[:, :, 2, 2].sqrt().mean() / fit.keypoints[..., 2].mean()
    assert 0.7 < float(depth_std) / float(fit.shape_std[length] / fit.shape[length]) < 1.2


def test_joints_are_told_with_what_no_point_tells(kinematics: HandKinematics) -> None:
    """Where makers put them; and before one camera, wherever it is, errors of size along the line of sight."""
    _, points = _truth(kinematics, 3)
    generator, cameras = torch.Generator().manual_seed(5), _cameras(2)
    seen = [_seen(points, camera, generator, 2.0, 0.01) for camera in cameras]
    both = fit_keypoints(kinematics, seen)
    centres = (both.joints_covariance() - both.keypoints_covariance)[0]
    torch.testing.assert_close(centres, centre_covariance(both.keypoints[0]), rtol=0, atol=1e-15)
    one, camera = fit_keypoints(kinematics, seen[1]), cameras[1]
    of_size = (one.joints_covariance(camera) - one.joints_covariance())[0, 9]
    away = one.keypoints[0, 9] + camera.rotation.T @ camera.translation
    torch.testing.assert_close(of_size, torch.outer(away, away) * (of_size.trace() / away.square().sum()))
    assert float(of_size.trace().sqrt() / away.norm()) == pytest.approx(0.04)


def test_what_is_told_of_joints_is_honest(data_dir: Path, kinematics: HandKinematics) -> None:
    """Of another maker's hand that a detector saw from four sides at the same times: most joints lie in their region,
    and no camera is late."""
    folder = data_dir / "synthetic" / "mv_motion"
    truth = torch.from_numpy(np.load(folder / "truth.npz")["keypoints3d"])
    seen = []
    for view, camera in enumerate(load_cameras(folder / "cameras.json")):
        found = np.load(folder / f"mediapipe_view_{view}.npz")
        px, own = (torch.from_numpy(found[name]).double() for name in ("points_px", "world"))
        seen.append(SeenKeypoints(camera=camera, points_px=px, points=own))
    fit = fit_keypoints(kinematics, seen, fit_shape=True, settings=KeypointFitSettings(is_recording=True))
    assert max(map(abs, fit.lags)) < 0.2
    missed = (fit.keypoints - truth)[..., None]
    nees = (missed.mT @ torch.linalg.solve(fit.joints_covariance(), missed)).squeeze()
    assert 0.8 < float((nees < 7.815).double().mean()) <= 1  # 95 % of a chi-squared distribution of three
