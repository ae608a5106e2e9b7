"""The hand fitted to keypoints: exact where the points are, honest where they are noisy or missing, within limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import free_bounds
from torchhand.fit.keypoints.fit import KeypointFit, fit_keypoints
from torchhand.fit.keypoints.settings import KeypointFitSettings
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector, vector_from_rotation
from torchhand.hand import (
    DOFS,
    Anthropometry,
    HandKinematics,
    Side,
    moving_parameters,
    named_pose_space,
    posture,
)
from torchhand.hand.limits import clamp_to_limits

DOUBLE = torch.float64
DOF27 = named_pose_space("dof27")
POSTURES = ("open", "flat", "fist", "point", "victory", "thumb_up")


def _hand(side: Side = "right") -> HandKinematics:
    return load_hand_model().kinematics(side, dtype=DOUBLE)


def _random_poses(kinematics: HandKinematics, count: int, generator: torch.Generator, *, margin: float = 0.0) -> Tensor:
    """Uniform between the limits (less a margin at both ends, as a share), any rotation of the root."""
    lower, upper = free_bounds(DOF27, kinematics.skeleton)
    fraction = margin + (1 - 2 * margin) * torch.rand(count, DOF27.size, generator=generator, dtype=DOUBLE)
    free = torch.where(lower.isfinite(), lower + fraction * (upper - lower), fraction - 0.5)
    quaternion = torch.randn(count, 4, generator=generator, dtype=DOUBLE)
    axis, half = quaternion[:, 1:], torch.atan2(quaternion[:, 1:].norm(dim=-1), quaternion[:, 0])
    free[:, 3:6] = 2 * half[:, None] * axis / axis.norm(dim=-1, keepdim=True)
    return DOF27.dof(free)


def _postures(kinematics: HandKinematics) -> Tensor:
    """Named postures within the limits before a camera, the palm turned to it, each turned a little differently."""
    poses = torch.stack([posture(name, dtype=torch.float64) for name in POSTURES])
    poses[:, 6:] = kinematics.skeleton.within_limits(poses[:, 6:])
    poses[:, :3] = torch.tensor((0.0, 0.05, 0.5), dtype=DOUBLE)
    facing = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)), dtype=DOUBLE)
    turns = torch.linspace(-0.5, 0.5, len(POSTURES), dtype=DOUBLE)[:, None] * torch.tensor((1.0, -0.7, 0.4)).to(DOUBLE)
    poses[:, 3:6] = vector_from_rotation(rotation_from_vector(turns) @ facing)
    return poses


def _worst_angle_deg(found: Tensor, truth: Tensor) -> Tensor:
    """Of every frame, over the joint angles and the rotation of the root."""
    difference = rotation_from_vector(found[..., 3:6]) @ rotation_from_vector(truth[..., 3:6]).mT
    root = vector_from_rotation(difference).norm(dim=-1, keepdim=True)
    return torch.cat((root, (found - truth)[..., 6:].abs()), -1).amax(-1).rad2deg()


def _keeps_limits(fit: KeypointFit, kinematics: HandKinematics) -> bool:
    joints = fit.pose[fit.is_fitted][:, 6:]
    return bool(((joints >= kinematics.skeleton.lower) & (joints <= kinematics.skeleton.upper)).all())


@pytest.mark.parametrize("side", ["right", "left"])
def test_exact_points_give_the_exact_pose(side: Side, generator: torch.Generator) -> None:
    """Any feasible pose of the 27-DOF hand, also near its singular ones, known shape; every frame counts."""
    kinematics = _hand(side)
    truth = _random_poses(kinematics, 1000, generator)
    noise = torch.randn(len(kinematics.default_shape), generator=generator, dtype=DOUBLE)
    shape = kinematics.default_shape + 0.5 * noise * kinematics.shape_space.std
    points = kinematics(truth, shape).keypoints
    fit = fit_keypoints(kinematics, points, shape=shape)
    assert bool(fit.is_fitted.all())
    assert float((fit.keypoints - points).norm(dim=-1).max()) < 1e-6
    assert float(_worst_angle_deg(fit.pose, truth).max()) < 0.01
    assert _keeps_limits(fit, kinematics)
    torch.testing.assert_close(fit.residual, torch.zeros_like(fit.residual), atol=1e-6, rtol=0)
    torch.testing.assert_close(kinematics(fit.pose, shape).keypoints, fit.keypoints, atol=1e-12, rtol=0)


@pytest.mark.parametrize("name", ["dof26", "dof28", "dof31", "dof36"])
def test_other_pose_spaces(name: str, generator: torch.Generator) -> None:
    """Bent fingers, whose twists the points show; ties are kept until the angle that follows is at its limit."""
    kinematics, space = _hand(), named_pose_space(name)
    lower, upper = free_bounds(space, kinematics.skeleton)
    fraction = 0.3 + 0.4 * torch.rand(50, space.size, generator=generator, dtype=DOUBLE)
    free = torch.where(lower.isfinite(), lower + fraction * (upper - lower), fraction)
    truth = clamp_to_limits(space.dof(free), kinematics.skeleton)
    fit = fit_keypoints(kinematics, kinematics(truth).keypoints, space=space)
    assert _keeps_limits(fit, kinematics)
    tied = clamp_to_limits(space.dof(space.own(fit.pose)), kinematics.skeleton)
    torch.testing.assert_close(tied, fit.pose, atol=1e-12, rtol=0)
    assert float(fit.residual.max()) < 1e-5
    determined = [i for i, dof in enumerate(DOFS) if i >= 6 and not dof.endswith(("_tw", "cmc_fe", "cmc_aa"))]
    if name != "dof36":  # there a bend of the palm and the place of the root are nearly the same
        assert float((fit.pose - truth)[:, determined].abs().max().rad2deg()) < 0.5


def test_limits_hold_for_points_of_no_hand(generator: torch.Generator) -> None:
    kinematics = _hand()
    wild = _random_poses(kinematics, 60, generator)
    wild[:, 6:] += 0.8 * torch.randn(60, 30, generator=generator, dtype=DOUBLE)
    points = kinematics(wild).keypoints + 0.02 * torch.randn(60, 21, 3, generator=generator, dtype=DOUBLE)
    for name in ("dof26", "dof27", "dof36"):
        fit = fit_keypoints(kinematics, points, space=named_pose_space(name))
        assert bool(fit.is_fitted.all())
        assert _keeps_limits(fit, kinematics)


def test_spreads_are_honest(generator: torch.Generator) -> None:
    kinematics = _hand("left")
    truth = _random_poses(kinematics, 400, generator, margin=0.15)
    points = kinematics(truth).keypoints
    noise = 0.001 * torch.randn(points.shape, generator=generator, dtype=DOUBLE)
    fit = fit_keypoints(kinematics, points + noise, settings=KeypointFitSettings(noise=0.001))
    free = fit.pose_std[0] > 0
    score = ((fit.pose - truth) / fit.pose_std)[:, free]
    inside = (score[:, 6:].abs() < 1.96).double().mean()
    assert 0.92 < float(inside) < 0.975
    assert 0.9 < float(score[:, :3].square().mean().sqrt()) < 1.1
    assert not fit.pose_std[:, [DOFS.index("index_mcp_tw")]].any()
    # The whole covariance, of angles and keypoints: normalised squared errors have the mean of their dimension.
    error = (fit.pose - truth)[:, free]
    difference = rotation_from_vector(fit.pose[:, 3:6]) @ rotation_from_vector(truth[:, 3:6]).mT
    error[:, 3:6] = vector_from_rotation(difference)
    nees = (error * torch.linalg.solve(fit.pose_covariance, error)).sum(-1)
    assert 0.9 < float(nees.median()) / 27 < 1.15
    missed = (fit.keypoints - points)[..., None]
    nees = (missed.mT @ torch.linalg.solve(fit.keypoints_covariance, missed)).squeeze()
    assert 0.9 < float(nees[:, 1:].mean()) / 3 < 1.15


def test_missing_points_widen_the_spread_and_follow_the_natural_posture(generator: torch.Generator) -> None:
    kinematics = _hand()
    truth = _postures(kinematics)
    points = kinematics(truth).keypoints
    holes = points.clone()
    holes[:, 7:9] = torch.nan  # index: end joint and tip
    trust = torch.ones(len(points), 21, dtype=DOUBLE)
    trust[:, 20] = 0.0  # little fingertip
    whole = fit_keypoints(kinematics, points)
    fit = fit_keypoints(kinematics, holes, confidence=trust)
    assert bool(fit.is_fitted.all())
    assert fit.pose.isfinite().all()
    assert bool(fit.residual[:, [7, 8, 20]].isnan().all())
    seen = [i for i in range(21) if i not in (6, 7, 8, 19, 20)]
    torch.testing.assert_close(fit.keypoints[:, seen], points[:, seen], atol=2e-3, rtol=0)
    for dof, minimum in (("index_dip_fe", 0.15), ("index_pip_fe", 0.25), ("little_dip_fe", 0.15)):
        i = DOFS.index(dof)
        assert bool((fit.pose_std[:, i] > minimum).all())
        assert bool((fit.pose_std[:, i] < 1.0).all())
    for dof in ("thumb_ip_fe", "middle_mcp_fe", "ring_pip_fe"):
        i = DOFS.index(dof)
        torch.testing.assert_close(fit.pose_std[:, i], whole.pose_std[:, i], atol=0.01, rtol=0)


def test_confidence_is_information(generator: torch.Generator) -> None:
    """A quarter of the confidence is twice the noise."""
    kinematics = _hand()
    points = kinematics(_postures(kinematics)).keypoints
    points = points + 0.003 * torch.randn(points.shape, generator=generator, dtype=DOUBLE)
    settings = KeypointFitSettings(prior="never")
    low = fit_keypoints(kinematics, points, confidence=torch.full((6, 21), 0.25, dtype=DOUBLE), settings=settings)
    noisy = fit_keypoints(kinematics, points, settings=replace(settings, noise=2 * settings.noise))
    torch.testing.assert_close(low.pose_std, noisy.pose_std, atol=1e-9, rtol=0)
    torch.testing.assert_close(low.pose, noisy.pose, atol=1e-5, rtol=0)


def test_a_gross_error_does_not_spoil_the_frame() -> None:
    kinematics = _hand()
    truth = _postures(kinematics)
    points = kinematics(truth).keypoints
    spoilt = points.clone()
    spoilt[:, 12] += 0.1
    robust = fit_keypoints(kinematics, spoilt).keypoints
    squares = fit_keypoints(kinematics, spoilt, settings=KeypointFitSettings(gross=float("inf"))).keypoints
    others = [i for i in range(21) if i not in (10, 11, 12)]
    worst = (robust - points)[:, others].norm(dim=-1).max()
    assert float(worst) < 0.01
    assert float(worst) < 0.5 * float((squares - points)[:, others].norm(dim=-1).max())


def test_frames_that_cannot_be_fitted_have_a_status_and_harm_no_other() -> None:
    kinematics = _hand()
    points = kinematics(_postures(kinematics)).keypoints
    points[1] = torch.nan
    points[2, 4:] = torch.inf
    points[4, 3] = torch.inf
    fit = fit_keypoints(kinematics, points.reshape(2, 3, 21, 3))
    names = ["fitted", "too few points", "too few points", "fitted", "fitted", "fitted"]
    assert fit.status_names() == names
    for field in ("pose", "pose_std", "pose_covariance", "keypoints", "keypoints_covariance", "residual"):
        flat = getattr(fit, field).flatten(0, 1)
        assert bool(flat[1:3].isnan().all())
    good = [0, 3, 5]
    alone = fit_keypoints(kinematics, points[good])
    torch.testing.assert_close(fit.pose.flatten(0, 1)[good], alone.pose, atol=1e-9, rtol=0)
    nothing = fit_keypoints(kinematics, torch.full((2, 21, 3), torch.nan, dtype=DOUBLE), fit_shape=True)
    assert nothing.status_names() == ["too few points"] * 2
    torch.testing.assert_close(nothing.shape, kinematics.default_shape, atol=0, rtol=0)
    assert fit_keypoints(kinematics, torch.zeros(0, 21, 3, dtype=DOUBLE)).pose.shape == (0, 36)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], generator: torch.Generator) -> None:
    kinematics = _hand()
    count = int(np.prod(batch))
    points = kinematics(_random_poses(kinematics, count, generator)).keypoints
    points = points + 0.002 * torch.randn(points.shape, generator=generator, dtype=DOUBLE)
    fit = fit_keypoints(kinematics, points.reshape(*batch, 21, 3))
    for i in range(count):
        alone = fit_keypoints(kinematics, points[i])
        for field in ("pose", "pose_std", "keypoints", "residual", "status"):
            part = getattr(fit, field)
            part = part.reshape(count, *part.shape[len(batch) :])[i]
            torch.testing.assert_close(part, getattr(alone, field), atol=1e-9, rtol=0)


def test_one_shape_for_all_frames(generator: torch.Generator) -> None:
    """Recovered from many postures with little noise, as far as the belief in the population lets it."""
    kinematics = _hand()
    space = kinematics.shape_space
    columns = list(moving_parameters(kinematics))
    true_shape = Anthropometry(space).sample(1, generator, dtype=torch.float64)[0]
    still = [i for i in range(len(space.names)) if i not in columns]
    true_shape[still] = space.default[still]
    poses = _random_poses(kinematics, 60, generator)
    points = kinematics(poses, true_shape).keypoints
    noise = 0.0005 * torch.randn(points.shape, generator=generator, dtype=DOUBLE)
    fit = fit_keypoints(kinematics, points + noise, fit_shape=True, settings=KeypointFitSettings(noise=0.0005))
    assert float((fit.keypoints - points).norm(dim=-1).mean()) < 0.0007
    assert Anthropometry(space).is_feasible(fit.shape)
    before = (true_shape - space.default)[columns] / space.std[columns]
    after = (true_shape - fit.shape)[columns] / space.std[columns]
    assert float(after.square().mean().sqrt()) < 0.5 * float(before.square().mean().sqrt())
    lengths = [space.names.index(f"{finger}_proximal") for finger in ("index", "middle", "ring", "little")]
    metres, wanted = space.metres(fit.shape), space.metres(true_shape)
    torch.testing.assert_close(metres[lengths], wanted[lengths], atol=5e-4, rtol=0)
    score = (fit.shape - true_shape)[columns] / fit.shape_std[columns]
    assert float(score.square().mean()) < 2.0
    assert not fit.shape_std[still].any()


def test_chosen_parameters_only() -> None:
    kinematics = _hand()
    names = kinematics.shape_space.names
    shape = kinematics.default_shape.clone()
    shape[names.index("index_middle")] *= 1.1
    points = kinematics(_postures(kinematics), shape).keypoints
    settings = KeypointFitSettings(noise=0.0005)
    fit = fit_keypoints(kinematics, points, fit_shape=["index_middle", "index_distal"], settings=settings)
    moved = (fit.shape - kinematics.default_shape).nonzero()[:, 0].tolist()
    assert set(moved) <= {names.index("index_middle"), names.index("index_distal")}
    assert abs(float(fit.shape[names.index("index_middle")] - shape[names.index("index_middle")])) < 0.002


def test_an_unknown_unit_is_found() -> None:
    kinematics = _hand()
    points = kinematics(_postures(kinematics)).keypoints
    fit = fit_keypoints(kinematics, 37.0 * points, settings=KeypointFitSettings(fit_scale=True))
    assert abs(37 * fit.scale - 1) < 1e-3
    torch.testing.assert_close(fit.keypoints, points, atol=5e-4, rtol=0)


def test_offsets_of_another_makers_keypoints(generator: torch.Generator) -> None:
    """Known up to what poses can take over: the points are met, the joint angles come out better than without."""
    kinematics = _hand()
    poses = _random_poses(kinematics, 80, generator)
    frames = kinematics(poses)
    offset = torch.zeros(21, 3, dtype=DOUBLE)
    offset[0], offset[1] = torch.tensor((0.0, 0.006, -0.006)), torch.tensor((0.006, 0.006, 0.0))
    points = frames.keypoints.clone()
    points[:, :2] += (frames.rotation[:, :1] @ offset[:2, :, None]).squeeze(-1)
    plain = fit_keypoints(kinematics, points)
    fit = fit_keypoints(kinematics, points, settings=KeypointFitSettings(offset_std=0.005))
    assert float(fit.residual.mean()) < 0.5 * float(plain.residual.mean())
    torch.testing.assert_close(fit.offsets[:2], offset[:2], atol=2e-3, rtol=0)


def _camera() -> Camera:
    return replace(
        assumed_camera(640, 480),
        rotation=rotation_from_vector(torch.tensor((0.1, -0.2, 0.05), dtype=DOUBLE)),
        translation=torch.tensor((0.02, -0.01, 0.05), dtype=DOUBLE),
        is_assumed=False,
    )


@pytest.mark.parametrize("side", ["right", "left"])
def test_points_in_a_picture(side: Side) -> None:
    """Exact pixels of a hand of known size: the pose in space."""
    kinematics, camera = _hand(side), _camera()
    truth = _postures(kinematics)
    points = kinematics(truth).keypoints
    settings = KeypointFitSettings(noise_px=0.02, starts=12)
    fit = fit_keypoints(kinematics, camera.project(points), camera=camera, settings=settings)
    assert bool(fit.is_fitted.all())
    assert _keeps_limits(fit, kinematics)
    assert float(fit.residual.amax(-1).median()) < 0.01
    error = (fit.keypoints - points).norm(dim=-1).mean(-1)
    assert float(error.median()) < 1e-3
    # a finger bent towards or away from the camera can look the same: a frame may end in the other one
    assert int((error > 3e-3).sum()) <= 1


def test_a_camera_per_frame_and_missing_points() -> None:
    kinematics, camera = _hand(), _camera()
    points = kinematics(_postures(kinematics)[:3]).keypoints
    intrinsics = camera.intrinsics.repeat(3, 1, 1)
    intrinsics[:, 0, 2] += torch.tensor((0.0, 30.0, -80.0))
    cameras = replace(
        camera,
        intrinsics=intrinsics,
        rotation=camera.rotation.expand(3, 3, 3),
        translation=camera.translation.expand(3, 3),
        distortion=camera.distortion.expand(3, 0),
    )
    pixels = cameras.project(points)
    pixels[:, 16] = torch.nan
    fit = fit_keypoints(kinematics, pixels, camera=cameras)
    for i in range(3):
        one = replace(camera, intrinsics=intrinsics[i])
        alone = fit_keypoints(kinematics, pixels[i], camera=one)
        torch.testing.assert_close(fit.pose[i], alone.pose, atol=1e-5, rtol=0)
    assert float(fit.residual.nan_to_num().max()) < 8.0
    assert bool((fit.pose[:, DOFS.index("root_tz")] > 0.2).all())


def test_one_persons_recorded_joints(data_dir: Path) -> None:
    """Another maker's joint centres, good to some 5 mm, of a left hand: every third frame."""
    recorded = torch.from_numpy(np.load(data_dir / "real" / "joints3d_stills" / "truth.npz")["keypoints3d"][::3]).to(
        DOUBLE
    )
    fits = {side: fit_keypoints(_hand(side), recorded, fit_shape=True) for side in ("left", "right")}
    assert float(fits["left"].residual.mean()) < 0.004
    assert float(fits["right"].residual.mean()) > 0.008
    assert _keeps_limits(fits["left"], _hand("left"))
    assert Anthropometry(_hand().shape_space).is_feasible(fits["left"].shape)
    with_offsets = fit_keypoints(
        _hand("left"), recorded, fit_shape=True, settings=KeypointFitSettings(offset_std=0.003)
    )
    assert float(with_offsets.residual.mean()) < 0.0025


def test_error_messages() -> None:
    kinematics = _hand()
    points = torch.zeros(4, 21, 3, dtype=DOUBLE)
    with pytest.raises(ValueError, match=r"camera: expected one for keypoints of 2 coordinates"):
        fit_keypoints(kinematics, points[..., :2])
    with pytest.raises(ValueError, match=r"camera: expected none for keypoints of 3 coordinates"):
        fit_keypoints(kinematics, points, camera=_camera())
    with pytest.raises(ValueError, match=r"confidence: expected 0 or more, got -1"):
        fit_keypoints(kinematics, points, confidence=-torch.ones(4, 21, dtype=DOUBLE))
    with pytest.raises(ValueError, match=r"fit_scale: expected points in space, got pixels"):
        fit_keypoints(kinematics, points[..., :2], camera=_camera(), settings=KeypointFitSettings(fit_scale=True))
    with pytest.raises(ValueError, match=r"'planar': expected one whose first six free parameters are the root's"):
        fit_keypoints(kinematics, points, space=named_pose_space("planar"))
    with pytest.raises(ValueError, match=r"fit_shape: unknown parameter 'nose'; allowed: hand_length"):
        fit_keypoints(kinematics, points, fit_shape=["nose"])
    with pytest.raises(ValueError, match=r"fit_shape: index_tip_radius moves no keypoint"):
        fit_keypoints(kinematics, points, fit_shape=["index_tip_radius"])
    two = replace(
        _camera(),
        intrinsics=_camera().intrinsics.expand(2, 3, 3),
        rotation=_camera().rotation.expand(2, 3, 3),
        translation=_camera().translation.expand(2, 3),
        distortion=_camera().distortion.expand(2, 0),
    )
    with pytest.raises(ValueError, match=r"camera: expected one, or one per frame \(4,\), got a batch of \(2,\)"):
        fit_keypoints(kinematics, points[..., :2], camera=two)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("noise", 0.0, "noise: expected above 0 and finite, got 0.0"),
        ("noise_px", float("nan"), "noise_px: expected above 0 and finite, got nan"),
        ("gross", 0.0, "gross: expected above 0, got 0.0"),
        ("prior", "often", "prior: expected one of auto, where_missing, always, never, got 'often'"),
        ("offset_std", -0.1, "offset_std: expected 0 or more"),
        ("starts", 0, "starts: expected 1 or more, got 0"),
    ],
)
def test_settings_are_checked(name: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        KeypointFitSettings(**{name: value})  # type: ignore[arg-type]


# ------------------------------------------------------------------ degenerate input


def test_pictures_with_too_few_points() -> None:
    """No frame at all, and none that can be fitted, are no errors."""
    kinematics, camera = _hand(), assumed_camera(640, 480, dtype=DOUBLE)
    for frames in (0, 2):
        fit = fit_keypoints(kinematics, torch.full((frames, 21, 2), torch.nan, dtype=DOUBLE), camera=camera)
        assert fit.status_names() == ["too few points"] * frames
        assert fit.pose.shape == (frames, 36)
        assert bool(fit.pose.isnan().all())


@pytest.mark.parametrize("fit_scale", [False, True])
def test_points_in_one_place_are_too_few(fit_scale: bool, generator: torch.Generator) -> None:
    """Zeros are what many detectors write where they saw no hand; they leave the other frames alone."""
    kinematics = _hand()
    truth = _random_poses(kinematics, 2, generator)
    points = kinematics(truth).keypoints
    empty = torch.zeros_like(points[:1])
    fit = fit_keypoints(
        kinematics, torch.cat((empty, points, empty + 0.3)), settings=KeypointFitSettings(fit_scale=fit_scale)
    )
    assert fit.status_names() == ["too few points", "fitted", "fitted", "too few points"]
    assert float(_worst_angle_deg(fit.pose[1:3], truth).max()) < 0.01
    assert fit.scale == pytest.approx(1.0, abs=1e-6)


def test_a_frame_that_fails_leaves_the_others_their_shape_and_covariance() -> None:
    """A camera of NaN, and points that overflow, in one frame of three that share a shape."""
    kinematics = _hand()
    poses = _postures(kinematics)[:3]
    cameras = assumed_camera(640, 480, dtype=DOUBLE)
    points = cameras.project(kinematics(poses).keypoints)
    intrinsics = cameras.intrinsics.repeat(3, 1, 1)
    intrinsics[1] = torch.nan
    cameras = replace(
        cameras,
        intrinsics=intrinsics,
        rotation=cameras.rotation.expand(3, 3, 3),
        translation=cameras.translation.expand(3, 3),
        distortion=cameras.distortion.expand(3, -1),
    )
    in_picture = fit_keypoints(kinematics, points, camera=cameras, fit_shape=True)
    in_space = kinematics(poses).keypoints
    in_space[1] *= 1e305
    for fit in (in_picture, fit_keypoints(kinematics, in_space, fit_shape=True)):
        assert fit.status_names() == ["fitted", "failed", "fitted"]
        assert bool(fit.pose_covariance[[0, 2]].isfinite().all())
        assert bool(fit.pose[1].isnan().all())
        assert bool(fit.shape_std.isfinite().all())
        assert _keeps_limits(fit, kinematics)


@pytest.mark.parametrize("factor", [float("nan"), 3.0])
def test_a_shape_that_no_hand_has_is_refused(factor: float) -> None:
    kinematics = _hand()
    with pytest.raises(ValueError, match="shape: hand_length: expected"):
        fit_keypoints(kinematics, torch.zeros(1, 21, 3, dtype=DOUBLE), shape=factor * kinematics.default_shape)
