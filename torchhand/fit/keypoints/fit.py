"""A hand fitted to 21 keypoints, in space or in a picture: a pose for every frame, one shape for all."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.errors import require_kind
from torchhand.fit import PosedHands, SharedSolution, SolveStatus, Stage
from torchhand.fit.keypoints.estimate import MIN_POINTS, KeypointEstimator, Measured
from torchhand.fit.keypoints.observation import PictureKeypoints
from torchhand.fit.keypoints.points import Detector, KeypointSettings, frames_of
from torchhand.fit.keypoints.posture import PostureKeypoints
from torchhand.fit.keypoints.prior import natural_posture
from torchhand.fit.keypoints.recording import PosePath, is_short_gap
from torchhand.fit.keypoints.relative import RelativeKeypoints
from torchhand.fit.keypoints.rig import RefinedCameras, ViewLag, box_side_px, refined_cameras, triangulated
from torchhand.fit.keypoints.seen import SeenKeypoints
from torchhand.fit.keypoints.settings import KeypointFitSettings
from torchhand.fit.keypoints.world import WorldKeypoints
from torchhand.geometry import Camera
from torchhand.hand import (
    HandFrames,
    HandKinematics,
    HandPose,
    PoseJacobian,
    PoseSpace,
    centre_covariance,
    moving_parameters,
    named_pose_space,
    scale_covariance,
)
from torchhand.numerics import RobustLoss
from torchhand.precision import require_exact, without_autocast

_AT_ONCE = 1024  # frames whose derivatives are held at a time

_MIN_RECORDED = 10  # frames that tell how a hand moves
_MAX_GAP = 10  # frames in a row without enough points in a recording that are filled from their neighbours
_LAG_STD = 1.0  # frames: spread of the lags of cameras behind the first one in a recording, which are at most 3
_NOISE_FRACTION = 0.025
"""Standard deviation of a point in a picture over the longer side of the box around the frame's points."""
_SIZE_STD = 0.04
"""Error of the size of what a detector sees in a picture, as a share: root mean square, over seven recordings of
another maker's hand, of the spread of MediaPipe's points over that of the joints, less 1 (0.91 to 1.00)."""
_OF_FRAMES = ("pose", "pose_std", "pose_covariance", "keypoints", "keypoints_covariance", "residual")

FIT_STATUSES = ("fitted", "too few points", "failed", "filled")
"""By the numbers in `KeypointFit.status`; filled are frames of a recording that have a pose from their neighbours."""


@dataclass(frozen=True, kw_only=True)
class KeypointFit:
    """Poses, one shape, and how far to trust them. Frames that are not fitted hold NaN."""

    pose: Float[Tensor, "*frames 36"]
    """Metres and radians; the rotation vector is that of world_from_hand."""
    pose_std: Float[Tensor, "*frames 36"]
    """Standard deviations, 0 for DOFs that the pose space holds; rotations of the root are about the world's axes."""
    pose_covariance: Float[Tensor, "*frames free free"]
    """Covariance of the pose space's free parameters; the root's rotation is a left perturbation. The limits count as
    information (a uniform distribution between them), so that it is finite; an angle at its limit keeps its spread."""
    shape: Float[Tensor, "shape"]
    shape_std: Float[Tensor, "shape"]
    """Standard deviations of the parameters; 0 for those that were frozen."""
    keypoints: Float[Tensor, "*frames 21 3"]
    """Our keypoints of the fitted hand, metres in the world."""
    keypoints_covariance: Float[Tensor, "*frames 21 3 3"]
    """m², from that of the pose, which takes the points' errors for independent; see `joints_covariance`."""
    residual: Float[Tensor, "*frames 21"]
    """Distance of each measured point from the fitted hand: metres, or px (the mean over several cameras). NaN for
    missing points."""
    status: Int[Tensor, "*frames"]
    """Index into FIT_STATUSES."""
    iterations: Int[Tensor, "*frames"]
    """Iterations of the poses' last solution."""
    scale: float
    """Metres per unit of the measured points in space; 1 unless it was asked for."""
    offsets: Float[Tensor, "21 3"]
    """The maker's keypoints less ours in the frames of the bones of a right hand, metres; zeros unless fitted."""
    space: PoseSpace
    lags: tuple[float, ...] = ()
    """Frames by which the cameras of a recording after the first one are behind it, in their order; empty where they
    are taken as synchronous."""

    @property
    def is_fitted(self) -> Tensor:
        return self.status == 0

    def joints_covariance(self, camera: Camera | None = None) -> Float[Tensor, "*frames 21 3 3"]:
        """Covariance of the joints themselves, m²: that of the keypoints, how far makers of hands and of detectors
        differ about where joints are, and before one camera the distance that comes of an error of size.

        camera: the camera of a fit to the points in its pictures alone, one or a batch with one per frame; None for
        several cameras, and for points in space.
        """
        covariance = self.keypoints_covariance + centre_covariance(self.keypoints)
        if camera is None or camera.kind != "pinhole":
            return covariance
        camera = camera.to(dtype=covariance.dtype, device=covariance.device)
        from_camera = camera.cam_from_world(self.keypoints) @ camera.rotation
        return covariance + scale_covariance(from_camera, _SIZE_STD)

    def to(self, device: torch.device) -> "KeypointFit":
        """The same fit on another device."""
        tensors = {f.name: getattr(self, f.name) for f in fields(self) if isinstance(getattr(self, f.name), Tensor)}
        moved = {name: value.to(device) for name, value in tensors.items()}
        return replace(self, **moved, space=self.space.to(device=device))

    def status_names(self) -> list[str]:
        """Names of the frames' status in order, flattened."""
        return [FIT_STATUSES[int(number)] for number in self.status.reshape(-1)]


@without_autocast
@torch.no_grad()
def fit_keypoints(
    kinematics: HandKinematics,
    keypoints: Float[Tensor, "*frames 21 d"] | SeenKeypoints | Sequence[SeenKeypoints],
    *,
    camera: Camera | None = None,
    confidence: Float[Tensor, "*frames 21"] | None = None,
    space: PoseSpace | None = None,
    shape: Float[Tensor, "shape"] | None = None,
    fit_shape: bool | Sequence[str] = False,
    settings: KeypointFitSettings | None = None,
) -> KeypointFit:
    """Pose of every frame, and what all frames share, from keypoints in space (metres), in pictures (px, `camera`), or
    of detectors before one camera or several that give both (`SeenKeypoints`, the same frames in each).

    Minimises ½ Σ confidence · |point - keypoint|² / noise² (Huber beyond `settings.gross`), plus, where
    `settings.prior` says so, the squared distance from the natural posture in units of its spread. Joint limits hold
    exactly; a DOF that the pose space ties to another stops at its own while the other goes on. All frames are solved
    at once, in the dtype of the kinematics (float32 or float64), to which all that is given is converted. Points that
    are not finite or have confidence 0 are missing.

    Points in space beside those in pictures count about their own mean, at the size that fits best, and as a posture.

    camera: one, or a batch with one per frame. space: the free DOFs, which must include all six of the root; the 27-DOF
    hand where it is None. shape: the start, the default hand where it is None. fit_shape: True fits all parameters
    that move keypoints, or name some; they stay near the population (std of the shape space) and within its bounds. One
    camera cannot tell size from distance, so hand_length then comes from that belief.

    Raises ValueError for shapes that do not fit together, negative confidences, a camera for points in space or none
    for pixels, half precision, spaces without the root, unknown parameter names, a shape that is not finite or outside
    its bounds; TypeError for what is no HandKinematics, and for what are no keypoints. A frame that cannot be fitted is
    no error: see `KeypointFit.status`.
    """
    require_kind("kinematics", kinematics, HandKinematics)
    settings = settings or KeypointFitSettings()
    like = kinematics.default_levers
    require_exact("kinematics", like.dtype)
    if isinstance(keypoints, Tensor):
        require_exact("keypoints", keypoints.dtype)
    space = (space or named_pose_space("dof27")).to(dtype=like.dtype, device=like.device)
    _check_space(space)
    if shape is not None:
        kinematics.shape_space.check_one(shape)
    shape = kinematics.default_shape if shape is None else shape.to(like)
    views = _views(keypoints, camera, confidence, settings)
    if views:
        batch, seen = views[0].batch_shape, [_usable(view.flat(like)) for view in views]
        seen, in_space = _agreeing(seen, settings)
        good = torch.stack([view.points_px.isfinite().any((-2, -1)) for view in seen]).any(0).nonzero()[:, 0]
        measured = _in_pictures(kinematics, shape, seen, good, settings)
        measured = replace(
            measured,
            triangulated=None if in_space is None else in_space[good],
            place=good if settings.is_recording else None,
        )
        count = len(seen[0].points_px)
    else:
        assert isinstance(keypoints, Tensor)
        batch = keypoints.shape[:-2]
        observed = _in_world(kinematics, keypoints.reshape(-1, 21, 3).to(like), confidence, settings)
        good, count = _good(observed.points), len(observed.points)
        measured = Measured(observed=observed.rows(good))
    estimator = KeypointEstimator(
        measured=measured,
        space=space,
        posture=natural_posture(dtype=like.dtype, device=like.device),
        columns=_free_columns(kinematics, fit_shape, settings.fit_scale),
        settings=settings,
    )
    if not len(good):
        return _placed(_nothing(estimator, shape), good, count, batch)
    fit = _placed(_result(estimator, shape), good, count, torch.Size((count,)))
    if settings.is_recording and int(fit.is_fitted.sum()) >= _MIN_RECORDED:
        fit = _smoothed(fit, kinematics)
    return _shaped(fit, batch)


@torch.no_grad()
def refine_cameras(views: Sequence[SeenKeypoints]) -> RefinedCameras:
    """Cameras whose turns are known to some 3° and places to 5 cm, by the points that they saw of one hand.

    Raises ValueError for fewer than two cameras, cameras in one place, and cameras that are no single pinhole camera.
    """
    settings = KeypointFitSettings()
    seen = [_usable(view.flat(torch.zeros((), dtype=torch.float64))) for view in views]
    points, std = [view.points_px for view in seen], [_std_px(view.points_px, settings)[0] for view in seen]
    return refined_cameras([view.camera for view in seen], points, std)


def _views(
    keypoints: "Tensor | SeenKeypoints | Sequence[SeenKeypoints]",
    camera: Camera | None,
    confidence: Tensor | None,
    settings: KeypointFitSettings,
) -> list[SeenKeypoints]:
    """What the cameras saw; nothing for points in space."""
    if isinstance(keypoints, Tensor):
        _check(keypoints, camera, confidence, settings.fit_scale)
        if camera is None:
            return []
        return [SeenKeypoints(camera=camera, points_px=keypoints, confidence=confidence)]
    views = [keypoints] if isinstance(keypoints, SeenKeypoints) else list(keypoints)
    if not views:
        raise ValueError("keypoints: expected those of at least one camera, got none")
    if camera is not None or confidence is not None or settings.fit_scale:
        raise ValueError("camera, confidence, fit_scale: expected none beside SeenKeypoints, which hold their own")
    for view in views:
        require_kind("keypoints", view, SeenKeypoints)
    for view in views[1:]:
        if view.batch_shape != views[0].batch_shape:
            raise ValueError(
                f"keypoints: expected the same frames for every camera, got {tuple(views[0].batch_shape)} and"
                f" {tuple(view.batch_shape)}"
            )
    return views


def _check(keypoints: Tensor, camera: Camera | None, confidence: Tensor | None, fit_scale: bool) -> None:
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


def _check_space(space: PoseSpace) -> None:
    root = space.basis[:6]
    if not torch.equal(root[:, :6], torch.eye(6).to(root)) or bool(root[:, 6:].any()) or bool(space.constant[:6].any()):
        raise ValueError(f"pose space {space.name!r}: expected one whose first six free parameters are the root's")


def _in_world(
    kinematics: HandKinematics,
    points: Float[Tensor, "frames 21 3"],
    confidence: Tensor | None,
    settings: KeypointFitSettings,
) -> WorldKeypoints:
    """A row for each frame."""
    trust = torch.ones_like(points[..., 0]) if confidence is None else confidence.to(points).reshape(-1, 21)
    is_known = points.isfinite().all(-1) & trust.isfinite() & (trust > 0)
    return WorldKeypoints(
        points=torch.where(is_known[..., None], points, torch.nan),
        kinematics=kinematics,
        settings=KeypointSettings(space_std_m=settings.noise, correlation=0.0),
        confidence=torch.where(is_known, trust, 0.0),
        loss=_loss(settings, 3),
        detector=_detector(points, settings),
    )


def _in_pictures(
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    views: Sequence[SeenKeypoints],
    good: Int[Tensor, "n"],
    settings: KeypointFitSettings,
) -> Measured:
    """A row for each good frame."""
    detector = _detector(shape, settings)
    pictures, coarse, relative, postures = [], [], [], []
    for number, view in enumerate(views):
        std, wide = _std_px(view.points_px, settings)
        seen = PictureKeypoints(
            points_px=view.points_px,
            kinematics=kinematics,
            camera=view.camera,
            settings=KeypointSettings(correlation=0.0),
            view=number,
            confidence=view.trust,
            std_px=std,
            cov_px=view.cov_px,
            loss=_loss(settings, 2),
            detector=detector,
        )
        if number and settings.is_recording:
            lag = ViewLag.of(view.points_px, std=_LAG_STD, place=len(detector.extra) + number - 1)
            seen = replace(seen, lag=lag)
        pictures.append(seen.rows(good))
        coarse.append(wide[good])
        if view.points is None:
            continue
        seen_in_space = RelativeKeypoints.of_points(view.points, kinematics, view.camera)
        own = replace(seen_in_space, detector=detector).rows(good)
        relative.append(own)
        postures.append(PostureKeypoints.of_points(own.points, kinematics, shape, KeypointSettings()))
    return Measured(
        observed=tuple(pictures), coarse_std_px=tuple(coarse), relative=tuple(relative), postures=tuple(postures)
    )


def _usable(view: SeenKeypoints) -> SeenKeypoints:
    """Without missing points, and with nothing in the frames of which too little is known."""
    points = torch.where(view.trust[..., None] > 0, view.points_px, torch.nan)
    is_bad = torch.ones(len(points), dtype=torch.bool, device=points.device)
    is_bad[_good(points)] = False
    return replace(view, points_px=points).without(is_bad)


def _agreeing(
    views: Sequence[SeenKeypoints], settings: KeypointFitSettings
) -> tuple[Sequence[SeenKeypoints], Float[Tensor, "frames 21 3"] | None]:
    """Without what a view shows of another hand than most, and the points that several views show; None for one."""
    if len(views) < 2:
        return views, None
    points = [view.points_px for view in views]
    found = triangulated([view.camera for view in views], points, [_std_px(own, settings)[1] for own in points])
    is_other = ~found.agrees & found.agrees.any(-1, keepdim=True)
    return [view.without(is_other[:, number]) for number, view in enumerate(views)], found.points


def _good(points: Float[Tensor, "frames 21 d"]) -> Int[Tensor, "n"]:
    """Frames with enough points, which are not all in one place."""
    is_known = points.isfinite().all(-1)
    return ((is_known.sum(-1) >= MIN_POINTS) & ~_is_one_point(points)).nonzero()[:, 0]


def _loss(settings: KeypointFitSettings, dimension: int) -> RobustLoss:
    if math.isfinite(settings.gross):
        return RobustLoss(kind="huber", scale=settings.gross, group=dimension)
    return RobustLoss(kind="squares", group=dimension)


def _detector(like: Tensor, settings: KeypointFitSettings) -> Detector:
    return replace(
        Detector.known(like), has_unknown_scale=settings.fit_scale, has_unknown_offsets=settings.offset_std > 0
    )


def _std_px(
    points: Float[Tensor, "frames 21 2"], settings: KeypointFitSettings
) -> tuple[Float[Tensor, "frames"], Float[Tensor, "frames"]]:
    """Standard deviations of points in pictures, and such as are not so small that only near starts can be told
    apart."""
    coarse = _NOISE_FRACTION * box_side_px(points)
    noise = coarse if settings.noise_px is None else torch.full_like(coarse, settings.noise_px)
    return noise, torch.maximum(noise, coarse)


def _is_one_point(points: Float[Tensor, "frames 21 d"]) -> Bool[Tensor, "frames"]:
    """Whether all points of a frame lie in one place: what detectors write where they saw no hand."""
    return (points.nan_to_num(torch.inf).amin(1) == points.nan_to_num(-torch.inf).amax(1)).all(-1)


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
    fixed = ("hand_length", "hand_breadth") if fit_scale else ()
    return tuple(i for i in chosen if names[i] not in fixed)


def _placed(fit: KeypointFit, rows: Tensor, count: int, batch: torch.Size) -> KeypointFit:
    """The fit of some frames among all frames."""

    def spread(part: Tensor, empty: int | float) -> Tensor:
        whole = part.new_full((count, *part.shape[1:]), empty)
        whole[rows] = part
        return whole.reshape((*batch, *part.shape[1:]))

    return replace(
        fit,
        **{name: spread(getattr(fit, name), torch.nan) for name in _OF_FRAMES},
        status=spread(fit.status, FIT_STATUSES.index("too few points")),
        iterations=spread(fit.iterations, 0),
    )


def _shaped(fit: KeypointFit, batch: torch.Size) -> KeypointFit:
    """With its frames in the shape of a batch."""
    names = (*_OF_FRAMES, "status", "iterations")
    return replace(fit, **{name: getattr(fit, name).reshape((*batch, *getattr(fit, name).shape[1:])) for name in names})


def _smoothed(fit: KeypointFit, kinematics: HandKinematics) -> KeypointFit:
    """The fit of a recording's frames (one dimension) by those before and after them, short gaps filled."""
    path = PosePath.of(HandPose.of(fit.pose), fit.pose_covariance, fit.is_fitted, fit.space)
    found = path.smoothed(path.motion(), kinematics.skeleton)
    is_told = fit.is_fitted | is_short_gap(fit.is_fitted, _MAX_GAP)
    frames = kinematics(found.pose.dofs, fit.shape, root_reference=found.pose.reference)
    spread = _keypoints_covariance(PoseJacobian(kinematics, fit.space.basis), found.pose, frames, found.covariance)

    def told(part: Tensor) -> Tensor:
        return torch.where(is_told.reshape(-1, *[1] * (part.ndim - 1)), part, torch.nan)

    return replace(
        fit,
        pose=told(found.pose.vector),
        pose_std=told(_std(fit.space, found.covariance)),
        pose_covariance=told(found.covariance),
        keypoints=told(frames.keypoints),
        keypoints_covariance=told(spread),
        status=torch.where(is_told & ~fit.is_fitted, FIT_STATUSES.index("filled"), fit.status),
    )


def _std(space: PoseSpace, covariance: Float[Tensor, "k free free"]) -> Float[Tensor, "k 36"]:
    """Standard deviations of the DOFs."""
    return ((space.basis @ covariance) * space.basis).sum(-1).clamp_min(0).sqrt()


def _keypoints_covariance(
    jacobian: PoseJacobian, pose: HandPose, frames: HandFrames, covariance: Float[Tensor, "k free free"]
) -> Float[Tensor, "k 21 3 3"]:
    """From that of the pose."""
    columns = jacobian(pose.dofs, frames).contiguous()
    return (columns.flatten(1, 2) @ covariance).unflatten(1, columns.shape[1:3]) @ columns.mT


def _result(estimator: KeypointEstimator, shape: Float[Tensor, "shape"]) -> KeypointFit:
    """The fit of the frames that have enough points."""
    found = estimator.estimate(shape)
    solution, space = found.solution, estimator.space
    observed = tuple(replace(one, detector=found.detector) for one in found.measured.points)
    jacobian = PoseJacobian(observed[0].kinematics, space.basis)
    parts = [
        _measured(
            [one.rows(rows) for one in observed], solution.pose[rows], solution, jacobian, solution.covariance[rows]
        )
        for rows in (slice(first, first + _AT_ONCE) for first in range(0, len(solution.pose), _AT_ONCE))
    ]
    keypoints, keypoints_covariance, residual = (torch.cat(own) for own in zip(*parts, strict=True))
    pose, std = solution.pose.vector, _std(space, solution.covariance)
    is_sound = solution.frame_status != SolveStatus.FAILED.value
    is_sound &= pose.isfinite().all(-1) & solution.covariance.isfinite().all((-2, -1))

    def sound(part: Tensor) -> Tensor:
        return torch.where(is_sound.reshape(-1, *[1] * (part.ndim - 1)), part, torch.nan)

    return KeypointFit(
        pose=sound(pose),
        pose_std=sound(std),
        pose_covariance=sound(solution.covariance),
        shape=solution.shape.clone(),
        shape_std=solution.shape_std.clone(),
        keypoints=sound(keypoints),
        keypoints_covariance=sound(keypoints_covariance),
        residual=sound(residual),
        status=torch.where(is_sound, 0, FIT_STATUSES.index("failed")),
        iterations=solution.frame_iterations.clone(),
        scale=float(found.detector.log_scale.exp()),
        offsets=found.detector.offsets.clone(),
        space=space,
        lags=tuple(float(one.lag) for one in found.measured.lags),
    )


def _measured(
    observed: Sequence[PictureKeypoints | WorldKeypoints],
    pose: HandPose,
    solution: SharedSolution,
    jacobian: PoseJacobian,
    covariance: Float[Tensor, "k free free"],
) -> tuple[Float[Tensor, "k 21 3"], Float[Tensor, "k 21 3 3"], Float[Tensor, "k 21"]]:
    """Keypoints, their covariances, and the distance of each measured point, on average over the cameras: metres, or
    px; NaN for missing ones."""
    hands = PosedHands(pose=pose, shape=solution.shape)
    frames = frames_of(observed[0].kinematics, hands)
    spread = _keypoints_covariance(jacobian, pose, frames, covariance)
    missed = []
    for one in observed:
        distance = one.associate(hands, Stage(gross_m=1.0)).distance(hands)
        missed.append(torch.where(one.is_known, distance, torch.nan))
    return frames.keypoints, spread, torch.stack(missed).nanmean(0)


def _nothing(estimator: KeypointEstimator, shape: Float[Tensor, "shape"]) -> KeypointFit:
    """The fit of no frame."""
    free = estimator.space.size
    observed = estimator.measured.points[0]
    detector = observed.detector
    assert detector is not None
    std = torch.zeros_like(shape)
    columns = list(estimator.columns)
    std[columns] = observed.kinematics.shape_space.std.to(shape)[columns]
    return KeypointFit(
        pose=shape.new_zeros(0, 36),
        pose_std=shape.new_zeros(0, 36),
        pose_covariance=shape.new_zeros(0, free, free),
        shape=shape.clone(),
        shape_std=std,
        keypoints=shape.new_zeros(0, 21, 3),
        keypoints_covariance=shape.new_zeros(0, 21, 3, 3),
        residual=shape.new_zeros(0, 21),
        status=torch.zeros(0, dtype=torch.long, device=shape.device),
        iterations=torch.zeros(0, dtype=torch.long, device=shape.device),
        scale=float(detector.log_scale.exp()),
        offsets=detector.offsets,
        space=estimator.space,
    )
