"""Where the cameras of a rig are, by the points of a hand that all of them saw: a calibration without a board.

Bundle adjustment (Triggs et al. 2000) in which every keypoint of every frame is a point of its own: nothing is believed
of the hand, so that what is wrong with its model does not turn cameras. The points are eliminated (Schur complement).
The first camera and the distance of the others from it, their root mean square, are held: points tell no unit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.keypoints.rig.triangulation import ViewRows, triangulated
from torchhand.geometry import Camera, centres_world, left_jacobian, rotation_from_vector, skew
from torchhand.numerics import LevenbergMarquardtSettings, NormalEquations, levenberg_marquardt

_TURN_STD, _SHIFT_STD = math.radians(3.0), 0.05  # radians, metres: what is known of a camera beforehand
_GROSS = (24.0, 8.0, 3.0)  # standard deviations beyond which a point counts for less (Cauchy), one after the other
_MIN_DEPTH = 0.01  # metres from the camera
_STEPS = 5  # of the points for each trial of the cameras
_SPREAD_STD = 1e-4  # of the logarithm of the cameras' mean square distance, which is held
_PARTS = 6  # of the recording, each left out once
_MIN_FRAMES = 4 * _PARTS
_DETERMINED = 0.5  # standard deviation over that beforehand, up to which a number counts as determined
_SETTINGS = LevenbergMarquardtSettings(iterations=50, cost_tolerance=1e-8)


@dataclass(frozen=True, kw_only=True)
class RefinedCameras:
    """Cameras as they were found to be, in the unit of the rig."""

    cameras: tuple[Camera, ...]
    change: Float[Tensor, "others 6"]
    """Turn (rotation vector, radians) and shift (metres) of the cameras after the first, in their own frames: x =
    exp(turn) · (R X + t) + shift."""
    covariance: Float[Tensor, "others 6 6"]
    """That of the curvature of the cost, scaled to the residuals, plus what leaving out each sixth of the recording
    changes (Tukey's jackknife): a detector's errors are alike in frames that follow each other. What is wrong alike in
    all frames it does not tell."""
    is_determined: Bool[Tensor, "others"]
    """Cameras of which the recording tells all six numbers at least twice as well as they were known beforehand."""


def refined_cameras(
    cameras: Sequence[Camera],
    points_px: Sequence[Float[Tensor, "frames 21 2"]],
    std_px: Sequence[Float[Tensor, "frames"]],
) -> RefinedCameras:
    """Two cameras or more, whose turns are known to some 3° and places to 5 cm.

    points_px: NaN for missing points. std_px: of the points of every view. Points of another hand than most views show
    do not count. With fewer than 24 frames in which two views agree nothing is determined.

    Raises ValueError for fewer than two cameras, cameras in one place, and cameras that show no depth.
    """
    if len(cameras) < 2:
        raise ValueError(f"cameras: expected two or more, got {len(cameras)}")
    if any(camera.kind != "pinhole" or camera.intrinsics.ndim > 2 for camera in cameras):
        raise ValueError("cameras: expected pinhole cameras, one for all frames")
    cameras = [camera.to(dtype=torch.float64) for camera in cameras]
    wide = [
        std.double() + _TURN_STD * camera.intrinsics[0, 0] for std, camera in zip(std_px, cameras, strict=True)
    ]  # all points of a view may be off by its turn
    points = [own.double() for own in points_px]
    found = triangulated(cameras, points, wide)
    seen = [own.where(found.agrees[:, view, None, None], torch.nan) for view, own in enumerate(points)]
    is_used = found.agrees.any(-1)
    rows = [
        ViewRows.of(camera, own[is_used], std.double()[is_used])
        for camera, own, std in zip(cameras, seen, std_px, strict=True)
    ]
    prior = torch.tensor([_TURN_STD] * 3 + [_SHIFT_STD] * 3, dtype=torch.float64).repeat(len(cameras) - 1, 1)
    bundle = _Bundle(rows, found.points[is_used], prior)
    change = bundle.adjusted(torch.zeros_like(prior))
    covariance = bundle.covariance(change) + _jackknife(bundle, change)
    places = torch.arange(prior.numel()).reshape(prior.shape)
    own = covariance[places[:, :, None], places[:, None]]
    is_determined = (own.diagonal(dim1=-2, dim2=-1).sqrt() <= _DETERMINED * prior).all(-1)
    return RefinedCameras(
        cameras=tuple(bundle.cameras(change)),
        change=change,
        covariance=own,
        is_determined=is_determined & (int(is_used.sum()) >= _MIN_FRAMES),
    )


class _Bundle:
    """All points that two views or more saw, and the cameras' changes as unknowns."""

    def __init__(
        self, rows: Sequence[ViewRows], points: Float[Tensor, "frames 21 3"], prior: Float[Tensor, "others 6"]
    ) -> None:
        """points: where they are before the cameras are changed. prior: standard deviations of the changes."""
        self.rows, self.points, self.prior = rows, points, prior
        self._plane = torch.stack([one.plane for one in rows])
        weight = torch.stack([one.weight for one in rows])
        is_point = ((weight > 0).sum(0) >= 2) & points.isfinite().all(-1)
        self._weight = weight * is_point
        self._gross = _GROSS[-1]
        self._start = torch.where(is_point[..., None], points, 1.0)
        self._spread = _log_spread([one.camera for one in rows])
        if not bool(self._spread.isfinite()):
            raise ValueError("cameras: expected them in different places, got one place")

    def without(self, part: Tensor) -> "_Bundle":
        """Without some of the frames."""
        left = torch.ones(len(self.points), dtype=torch.bool)
        left[part] = False
        rows = [replace(one, plane=one.plane[left], weight=one.weight[left]) for one in self.rows]
        return _Bundle(rows, self.points[left], self.prior)

    def cameras(self, change: Float[Tensor, "others 6"]) -> list[Camera]:
        """The cameras with their changes."""
        first, *others = (one.camera for one in self.rows)
        return [first, *(_moved(camera, own) for camera, own in zip(others, change, strict=True))]

    def adjusted(self, start: Float[Tensor, "others 6"]) -> Float[Tensor, "others 6"]:
        """The changes of least cost."""
        values = start.flatten()
        for self._gross in _GROSS:
            values = levenberg_marquardt(self._equations, values, settings=_SETTINGS).values
        return values.reshape(start.shape)

    def covariance(self, change: Float[Tensor, "others 6"]) -> Float[Tensor, "n n"]:
        """By the curvature, with the residuals as large as they are."""
        found = self._equations(change.flatten())
        residual = self._residuals(self.cameras(change), self._placed(self.cameras(change)))[0].norm(dim=-1)
        size = residual[self._weight > 0].median() / math.sqrt(2 * math.log(2))  # of the two axes, robustly
        known = self.prior.flatten().square().reciprocal().diag()
        return torch.linalg.pinv((found.matrix - known) / size.square().clamp_min(1e-12) + known, hermitian=True)

    def _equations(self, values: Float[Tensor, "n"]) -> NormalEquations:
        change = values.reshape(self.prior.shape)
        cameras = self.cameras(change)
        points = self._placed(cameras)
        residual, by_point, by_place = self._residuals(cameras, points)
        square = residual.square().sum(-1)
        cost = 0.5 * self._gross**2 * (square / self._gross**2).log1p().sum()
        trust = (1 + square / self._gross**2).reciprocal()[..., None, None]
        turns = torch.stack([left_jacobian(own[:3]) for own in change])
        shifts = change[:, None, None, 3:]
        levers = by_place.in_cam[1:] - shifts
        own = torch.cat(
            (-skew(levers) @ turns[:, None, None], torch.eye(3).to(levers).expand(*levers.shape[:-1], 3, 3)), -1
        )
        by_camera = by_place.slopes[1:] @ own  # others frames 21 2 6
        of_points = (trust * by_point).mT @ by_point
        whole = of_points.sum(0)
        whole = whole + 1e-9 * (1 + whole.diagonal(dim1=-2, dim2=-1).sum(-1))[..., None, None] * torch.eye(3).to(whole)
        mixed = (trust[1:] * by_camera).mT @ by_point[1:]  # others frames 21 6 3
        stacked = mixed.movedim(0, 2).flatten(2, 3)  # frames 21 n 3
        matrix = -(stacked @ torch.linalg.solve(whole, stacked.mT)).sum((0, 1))
        blocks = ((trust[1:] * by_camera).mT @ by_camera).sum((1, 2))
        matrix = matrix + torch.block_diag(*blocks)
        gradient = ((trust[1:] * by_camera).mT @ residual[1:, ..., None]).sum((1, 2))[..., 0].flatten()
        held = (_log_spread(cameras) - self._spread) / _SPREAD_STD
        slope = self._spread_slope(cameras, change).flatten() / _SPREAD_STD
        information = self.prior.flatten().square().reciprocal()
        return NormalEquations(
            matrix=matrix + information.diag() + slope[:, None] * slope,
            gradient=gradient + information * values + held * slope,
            cost=cost + 0.5 * (information * values.square()).sum() + 0.5 * held.square(),
        )

    def _spread_slope(self, cameras: Sequence[Camera], change: Float[Tensor, "others 6"]) -> Float[Tensor, "others 6"]:
        """Derivative of the logarithm of the cameras' mean square distance."""
        centres = centres_world(cameras)
        away = centres[1:] - centres[0]
        weight = 2 * away / away.square().sum()
        found = []
        for own, camera, one, pull in zip(self.rows[1:], cameras[1:], change, weight, strict=True):
            # the centre is -Rᵀ (t + exp(-turn) shift)
            back = rotation_from_vector(-one[:3])
            by_turn = -own.camera.rotation.mT @ skew(back @ one[3:]) @ left_jacobian(-one[:3])
            found.append(torch.cat((pull @ by_turn, -pull @ camera.rotation.mT)))
        return torch.stack(found)

    def _placed(self, cameras: Sequence[Camera]) -> Float[Tensor, "frames 21 3"]:
        """The points of least cost before some cameras."""
        points = self._start
        for _ in range(_STEPS):
            residual, by_point, _ = self._residuals(cameras, points)
            trust = (1 + residual.square().sum(-1) / self._gross**2).reciprocal()[..., None, None]
            matrix = ((trust * by_point).mT @ by_point).sum(0)
            gradient = ((trust * by_point).mT @ residual[..., None]).sum(0)
            size = 1 + matrix.diagonal(dim1=-2, dim2=-1).sum(-1)
            step = torch.linalg.solve(matrix + 1e-9 * size[..., None, None] * torch.eye(3).to(matrix), gradient)
            points = points - step[..., 0]
        return points

    def _residuals(
        self, cameras: Sequence[Camera], points: Float[Tensor, "frames 21 3"]
    ) -> tuple[Float[Tensor, "views frames 21 2"], Float[Tensor, "views frames 21 2 3"], "_InCameras"]:
        """How far points are from where they are seen, in standard deviations, and the derivatives in the points."""
        rotation = torch.stack([camera.rotation for camera in cameras])[:, None, None]
        in_cam = torch.stack([camera.cam_from_world(points) for camera in cameras])
        nearness = in_cam[..., 2:].clamp_min(_MIN_DEPTH).reciprocal()
        plane = in_cam[..., :2] * nearness
        slopes = torch.zeros(*plane.shape, 3).to(plane)
        slopes[..., 0, 0] = slopes[..., 1, 1] = nearness[..., 0]
        slopes[..., 2] = -plane * nearness
        slopes = self._weight[..., None, None] * slopes
        residual = self._weight[..., None] * (plane - self._plane)
        return residual, slopes @ rotation, _InCameras(in_cam=in_cam, slopes=slopes)


@dataclass(frozen=True, kw_only=True)
class _InCameras:
    """Points in the frames of the cameras, and the derivatives of the residuals there."""

    in_cam: Float[Tensor, "views frames 21 3"]
    slopes: Float[Tensor, "views frames 21 2 3"]


def _moved(camera: Camera, change: Float[Tensor, "6"]) -> Camera:
    turn = rotation_from_vector(change[:3])
    return replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation + change[3:])


def _log_spread(cameras: Sequence[Camera]) -> Float[Tensor, ""]:
    """Logarithm of the mean square distance of the cameras from the first."""
    centres = centres_world(cameras)
    return (centres[1:] - centres[0]).square().sum(-1).mean().log()


def _jackknife(bundle: _Bundle, change: Float[Tensor, "others 6"]) -> Float[Tensor, "n n"]:
    """Covariance of the changes by leaving out one part of the recording after the other."""
    parts = torch.arange(len(bundle.points)).tensor_split(min(_PARTS, len(bundle.points)))
    if len(parts) < 2:
        return torch.zeros(change.numel(), change.numel()).to(change)
    each = torch.stack([bundle.without(part).adjusted(change).flatten() for part in parts])
    away = each - each.mean(0)
    return (len(each) - 1) / len(each) * away.T @ away
