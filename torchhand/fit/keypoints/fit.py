"""A hand fitted to 21 keypoints, in space or in a picture: a pose for every frame, one shape for all."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit.keypoints.prior import NaturalPosture, natural_posture
from torchhand.fit.keypoints.residuals import Observations
from torchhand.fit.keypoints.settings import KeypointFitSettings
from torchhand.fit.keypoints.solver import KeypointSolution, KeypointSolver
from torchhand.geometry import Camera, left_jacobian, rotation_from_vector, vector_from_rotation
from torchhand.hand import HandKinematics, PoseSpace, moving_parameters, named_pose_space
from torchhand.numerics import Status

FIT_STATUSES = ("fitted", "too few points", "failed")
"""By the numbers in `KeypointFit.status`."""


@dataclass(frozen=True, kw_only=True)
class KeypointFit:
    """Poses, one shape, and how far to trust them. Frames that are not fitted hold NaN."""

    pose: Float[Tensor, "*frames 36"]
    """Metres and radians; the rotation vector is that of world_from_hand."""
    pose_std: Float[Tensor, "*frames 36"]
    """Standard deviations, 0 for DOFs that the pose space holds; rotations of the root are about the world's axes."""
    pose_covariance: Float[Tensor, "*frames free free"]
    """Of the pose space's free parameters; the root's rotation is a left perturbation. The limits count as information
    (a uniform distribution between them), so that it is finite; an angle at its limit keeps its spread."""
    shape: Float[Tensor, "shape"]
    shape_std: Float[Tensor, "shape"]
    """0 for parameters that were held."""
    keypoints: Float[Tensor, "*frames 21 3"]
    """Our keypoints of the fitted hand, metres in the world."""
    keypoints_covariance: Float[Tensor, "*frames 21 3 3"]
    """m², from that of the pose."""
    residual: Float[Tensor, "*frames 21"]
    """Distance of each measured point from the fitted hand: metres, or px. NaN for missing points."""
    status: Int[Tensor, "*frames"]
    """Index into FIT_STATUSES."""
    iterations: Int[Tensor, "*frames"]
    """Of the poses' last solution."""
    scale: float
    """Metres per unit of the measured points in space; 1 unless it was asked for."""
    offsets: Float[Tensor, "21 3"]
    """The maker's keypoints less ours in the frames of the bones of a right hand, metres; zeros unless fitted."""
    space: PoseSpace

    @property
    def is_fitted(self) -> Tensor:
        return self.status == 0

    def status_names(self) -> list[str]:
        """Of the frames in order, flattened."""
        return [FIT_STATUSES[int(number)] for number in self.status.reshape(-1)]


@torch.no_grad()
def fit_keypoints(
    kinematics: HandKinematics,
    keypoints: Float[Tensor, "*frames 21 d"],
    *,
    camera: Camera | None = None,
    confidence: Float[Tensor, "*frames 21"] | None = None,
    space: PoseSpace | None = None,
    shape: Float[Tensor, "shape"] | None = None,
    fit_shape: bool | Sequence[str] = False,
    fit_scale: bool = False,
    posture: NaturalPosture | None = None,
    settings: KeypointFitSettings | None = None,
) -> KeypointFit:
    """Pose of every frame, and what all frames share, from keypoints in space (metres) or in pictures (px, `camera`).

    Minimises ½ Σ confidence · |point - keypoint|² / noise² (Huber beyond `settings.gross`), plus, where
    `settings.prior` says so, the squared distance from the natural posture in units of its spread. Joint limits hold
    exactly; DOFs that a pose space ties hold theirs through it. All frames are solved at once, in the dtype of the
    kinematics. Points that are not finite or have confidence 0 are missing.

    camera: one, or a batch with one per frame. space: the free DOFs, which must include all six of the root; the 27-DOF
    hand where it is None. shape: the start, the default hand where it is None. fit_shape: True fits all parameters
    that move keypoints, or name some; they stay near the population (std of the shape space) and within its bounds. One
    camera cannot tell size from distance, so hand_length then comes from that belief. fit_scale: points in space are
    in an unknown unit; hand length and breadth are then held.

    Raises ValueError for shapes that do not fit together, negative confidences, a camera for points in space or none
    for pixels, spaces without the root, unknown parameter names, a shape that is not finite or outside its bounds. A
    frame that cannot be fitted is no error: see `KeypointFit.status`.
    """
    settings = settings or KeypointFitSettings()
    like = kinematics.default_levers
    space = (space or named_pose_space("dof27")).to(dtype=like.dtype, device=like.device)
    _check(keypoints, camera, confidence, space, fit_scale)
    if shape is not None:
        kinematics.shape_space.check(shape)
    batch = keypoints.shape[:-2]
    observed = _observations(keypoints.to(like), camera, confidence, settings, batch)
    lower, upper = free_limits(space, kinematics)
    is_enough = (observed.is_known.sum(-1) >= settings.least_points) & ~_is_one_point(observed)
    good = is_enough.nonzero()[:, 0]
    solver = KeypointSolver(
        kinematics=kinematics,
        space=space,
        lower=lower,
        upper=upper,
        observed=observed.rows(good),
        posture=posture or natural_posture(dtype=like.dtype, device=like.device),
        columns=_free_columns(kinematics, fit_shape, fit_scale),
        fit_scale=fit_scale,
        settings=settings,
    )
    solution = solver.solve((kinematics.default_shape if shape is None else shape.to(like)).clone())
    return _placed(_result(solver, solution), good, len(observed.points), batch)


def free_limits(space: PoseSpace, kinematics: HandKinematics) -> tuple[Float[Tensor, "free"], Float[Tensor, "free"]]:
    """Limits of a pose space's free parameters that keep every joint angle within its own.

    A tie passes the limits of the angles that follow on. Raises ValueError where an angle depends on more than one
    free parameter, or the limits leave nothing.
    """
    basis, constant = space.basis[6:], space.constant[6:]
    if bool(((basis != 0).sum(-1) > 1).any()):
        raise ValueError(f"pose space {space.name!r}: expected every angle to depend on one free parameter at most")
    lower = basis.new_full((space.size,), -torch.inf)
    upper = -lower
    for row, column in basis.nonzero().tolist():
        factor = basis[row, column]
        ends = (torch.stack((kinematics.skeleton.lower[row], kinematics.skeleton.upper[row])).to(basis)) - constant[row]
        ends = (ends / factor).sort().values
        lower[column], upper[column] = torch.maximum(lower[column], ends[0]), torch.minimum(upper[column], ends[1])
    if bool((lower > upper).any()):
        name = space.free_names[int((lower > upper).nonzero()[0])]
        raise ValueError(f"pose space {space.name!r}: the limits of the angles tied to {name} leave nothing")
    return lower, upper


def _check(
    keypoints: Tensor, camera: Camera | None, confidence: Tensor | None, space: PoseSpace, fit_scale: bool
) -> None:
    dimension = keypoints.shape[-1]
    if keypoints.ndim < 2 or keypoints.shape[-2] != 21 or dimension not in (2, 3):
        raise ValueError(f"keypoints: expected shape (*frames, 21, 2 or 3), got {tuple(keypoints.shape)}")
    if (camera is None) != (dimension == 3):
        raise ValueError(
            f"camera: expected {'one' if dimension == 2 else 'none'} for keypoints of {dimension} coordinates"
        )
    if camera is not None and camera.intrinsics.shape[:-2] not in ((), keypoints.shape[:-2]):
        raise ValueError(
            f"camera: expected one, or one per frame {tuple(keypoints.shape[:-2])},"
            f" got a batch of {tuple(camera.intrinsics.shape[:-2])}"
        )
    if fit_scale and dimension == 2:
        raise ValueError("fit_scale: expected points in space, got pixels")
    if confidence is not None:
        if confidence.shape != keypoints.shape[:-1]:
            expected, got = tuple(keypoints.shape[:-1]), tuple(confidence.shape)
            raise ValueError(f"confidence: expected shape {expected}, got {got}")
        if bool((confidence < 0).any()):
            raise ValueError(f"confidence: expected 0 or more, got {float(confidence.min()):g}")
    root = space.basis[:6]
    if not torch.equal(root[:, :6], torch.eye(6).to(root)) or bool(root[:, 6:].any()) or bool(space.constant[:6].any()):
        raise ValueError(f"pose space {space.name!r}: expected one whose first six free parameters are the root's")


def _observations(
    keypoints: Tensor,
    camera: Camera | None,
    confidence: Tensor | None,
    settings: KeypointFitSettings,
    batch: torch.Size,
) -> Observations:
    points = keypoints.reshape(-1, 21, keypoints.shape[-1])
    trust = torch.ones_like(points[..., 0]) if confidence is None else confidence.to(points).reshape(-1, 21)
    is_known = points.isfinite().all(-1) & trust.isfinite() & (trust > 0)
    noise = torch.full_like(points[:, 0, 0], settings.noise)
    coarse = noise
    if camera is not None:
        known = torch.where(is_known[..., None], points, torch.nan)
        extent = (known.nan_to_num(-torch.inf).amax(1) - known.nan_to_num(torch.inf).amin(1)).amax(-1)
        coarse = settings.noise_share * extent.clamp_min(1.0)
        noise = coarse if settings.noise_px is None else torch.full_like(coarse, settings.noise_px)
        camera = camera.to(dtype=points.dtype, device=points.device)
        if camera.intrinsics.ndim > 2:
            camera = replace(
                camera,
                intrinsics=camera.intrinsics.reshape(-1, 3, 3),
                rotation=camera.rotation.expand(*batch, 3, 3).reshape(-1, 3, 3),
                translation=camera.translation.expand(*batch, 3).reshape(-1, 3),
                distortion=camera.distortion.expand(*batch, camera.distortion.shape[-1]).flatten(0, -2),
            )
    return Observations(
        points=torch.where(is_known[..., None], points, 0.0),
        confidence=torch.where(is_known, trust, 0.0),
        noise=noise,
        coarse_noise=torch.maximum(noise, coarse),
        camera=camera,
    )


def _is_one_point(observed: Observations) -> Bool[Tensor, "frames"]:
    """Whether all points of a frame lie in one place: what detectors write where they saw no hand."""
    is_known = observed.is_known[..., None]
    low = torch.where(is_known, observed.points, torch.inf).amin(1)
    high = torch.where(is_known, observed.points, -torch.inf).amax(1)
    return (low == high).all(-1)


def _free_columns(kinematics: HandKinematics, fit_shape: bool | Sequence[str], fit_scale: bool) -> tuple[int, ...]:
    names = kinematics.shape_space.names
    moving = moving_parameters(kinematics)
    if isinstance(fit_shape, bool):
        chosen = moving if fit_shape else ()
    else:
        if unknown := [name for name in fit_shape if name not in names]:
            raise ValueError(f"fit_shape: unknown parameter {unknown[0]!r}; allowed: {', '.join(names)}")
        if still := [name for name in fit_shape if names.index(name) not in moving]:
            raise ValueError(f"fit_shape: {still[0]} moves no keypoint")
        chosen = tuple(names.index(name) for name in fit_shape)
    held = ("hand_length", "hand_breadth") if fit_scale else ()
    return tuple(i for i in chosen if names[i] not in held)


def _placed(fit: KeypointFit, rows: Tensor, count: int, batch: torch.Size) -> KeypointFit:
    """The fit of some frames among all frames."""

    def spread(part: Tensor, empty: int | float) -> Tensor:
        whole = part.new_full((count, *part.shape[1:]), empty)
        whole[rows] = part
        return whole.reshape((*batch, *part.shape[1:]))

    names = ("pose", "pose_std", "pose_covariance", "keypoints", "keypoints_covariance", "residual")
    return replace(
        fit,
        **{name: spread(getattr(fit, name), torch.nan) for name in names},
        status=spread(fit.status, FIT_STATUSES.index("too few points")),
        iterations=spread(fit.iterations, 0),
    )


def _result(solver: KeypointSolver, solution: KeypointSolution) -> KeypointFit:
    """Of the frames that have enough points."""
    cost, found, common = solution.cost, solution.poses, solution.common
    pose, frames, residual = cost.distances(found.values, torch.arange(len(found.values)).to(found.status), common)
    covariance, common_covariance = solver.covariances(solution)
    # Of the rotation vector about the reference, the covariance becomes that of a further small rotation.
    about_world = torch.eye(solver.space.size).to(covariance).repeat(len(pose), 1, 1)
    about_world[:, 3:6, 3:6] = left_jacobian(pose[:, 3:6])
    covariance = about_world @ covariance @ about_world.mT
    turned = rotation_from_vector(pose[:, 3:6]) @ cost.reference
    pose = torch.cat((pose[:, :3], torch.zeros_like(pose[:, :3]), pose[:, 6:]), -1)
    columns = cost.pose_jacobian(pose, frames)
    pose = torch.cat((pose[:, :3], vector_from_rotation(turned), pose[:, 6:]), -1)
    basis = solver.space.basis
    std = (basis @ covariance @ basis.mT).diagonal(dim1=-2, dim2=-1).clamp_min(0).sqrt()
    shape_std = torch.zeros_like(common.shape)
    shape_std[list(solver.columns)] = common_covariance.diagonal()[: len(solver.columns)].clamp_min(0).sqrt()
    is_sound = (found.status != Status.FAILED) & pose.isfinite().all(-1) & covariance.isfinite().all((-2, -1))

    def sound(part: Tensor) -> Tensor:
        return torch.where(is_sound.reshape(-1, *[1] * (part.ndim - 1)), part, torch.nan)

    return KeypointFit(
        pose=sound(pose),
        pose_std=sound(std),
        pose_covariance=sound(covariance),
        shape=common.shape,
        shape_std=shape_std,
        keypoints=sound(frames.keypoints),
        keypoints_covariance=sound(columns @ covariance[:, None] @ columns.mT),
        residual=sound(residual),
        status=torch.where(is_sound, 0, FIT_STATUSES.index("failed")),
        iterations=found.iterations,
        scale=float(common.log_scale.exp()),
        offsets=common.offsets,
        space=solver.space,
    )
