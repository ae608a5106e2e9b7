"""Points in space from those in the pictures of several cameras, where some pictures may show another hand."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera

_MAX_STD = 4.0  # median distance of a hand's points from the picture's, in standard deviations, up to which they agree
_ROUNDS = 3  # of reweighting
_GROSS_STD = 4.0  # distance at which a point counts a quarter
_MIN_DEPTH = 0.01  # metres from the camera
_MIN_POINTS = 4  # of a hand that a view must show before it can agree or not
_BOX_STD = 0.025  # standard deviation of a point, shares of the longer side of the box around its hand


@dataclass(frozen=True, kw_only=True)
class Triangulated:
    """Points of one hand, frame by frame."""

    points: Float[Tensor, "frames 21 3"]
    """Metres in the world; NaN for points that fewer than two agreeing views show."""
    agrees: Bool[Tensor, "frames views"]
    """Views whose points are those of the hand that most views see. Where no two views agree, none does."""


def triangulated(
    cameras: Sequence[Camera],
    points_px: Sequence[Float[Tensor, "frames 21 2"]],
    std_px: Sequence[Float[Tensor, "frames"]] | None = None,
) -> Triangulated:
    """The hand that most views of every frame see, its points by robust linear least squares.

    Every pair of views proposes a hand; the one that most views agree with is taken, of several such the one that they
    agree with best. points_px: NaN for missing points. std_px: of the points of every view, from which follows how near
    is near enough; a share of their box where None. Cameras that show no depth (orthographic ones) count as any other.
    """
    std_px = [_BOX_STD * box_side_px(own) for own in points_px] if std_px is None else std_px
    rows = [ViewRows.of(*one) for one in zip(cameras, points_px, std_px, strict=True)]
    count, frames = len(rows), len(points_px[0])
    like = points_px[0]
    best = like.new_full((frames, 21, 3), torch.nan)
    agrees = torch.zeros(frames, count, dtype=torch.bool, device=like.device)
    rank = like.new_zeros(frames)
    for pair in itertools.combinations(range(count), 2):
        found = _solved([rows[view] for view in pair], [rows[view].weight for view in pair])
        away = torch.stack([one.typical(found) for one in rows], -1)
        near = away <= _MAX_STD
        is_pair = near[:, list(pair)].all(-1)
        spread = torch.where(near, away, 0.0).sum(-1) / near.sum(-1).clamp_min(1)
        own = torch.where(is_pair, near.sum(-1) + 1 - spread / (2 * _MAX_STD), 0.0)
        better = own > rank
        rank = torch.where(better, own, rank)
        best = torch.where(better[:, None, None], found, best)
        agrees = torch.where(better[:, None], near, agrees)
    for _ in range(_ROUNDS):
        weights = [one.weight * one.trust(best) * agrees[:, view, None] for view, one in enumerate(rows)]
        best = _solved(rows, weights)
    return Triangulated(points=best, agrees=agrees)


def box_side_px(points_px: Float[Tensor, "frames 21 2"]) -> Float[Tensor, "frames"]:
    """Longer side of the box around the points of each frame, at least a pixel."""
    extent = points_px.nan_to_num(-torch.inf).amax(1) - points_px.nan_to_num(torch.inf).amin(1)
    return extent.amax(-1).clamp_min(1.0)


@dataclass(frozen=True, kw_only=True)
class ViewRows:
    """The linear equations of one view's points: matrix · point = value, and how far a point is from its ray."""

    camera: Camera
    plane: Float[Tensor, "frames 21 2"]
    """Points in the plane at depth 1; 0 for missing ones."""
    weight: Float[Tensor, "frames 21"]
    """Inverse standard deviations in that plane; 0 for missing points."""

    @classmethod
    def of(cls, camera: Camera, points_px: Tensor, std_px: Tensor) -> "ViewRows":
        is_known = points_px.isfinite().all(-1)
        plane = camera.plane_from_pixels(torch.where(is_known[..., None], points_px, 0.0))
        is_known &= plane.isfinite().all(-1)
        scale = 0.5 * (camera.intrinsics[..., 0, 0] + camera.intrinsics[..., 1, 1]).to(plane)
        weight = is_known * (scale / std_px)[:, None]
        return cls(camera=camera, plane=torch.where(is_known[..., None], plane, 0.0), weight=weight)

    @property
    def _axes(self) -> tuple[Tensor, Tensor]:
        """Rotation and translation, with a dimension for points."""
        rotation, translation = self.camera.rotation.to(self.plane), self.camera.translation.to(self.plane)
        if rotation.ndim == 2:
            return rotation, translation
        return rotation[:, None], translation[:, None]

    def equations(self) -> tuple[Float[Tensor, "frames 21 2 3"], Float[Tensor, "frames 21 2"]]:
        rotation, translation = self._axes
        if self.camera.kind != "pinhole":
            return rotation[..., :2, :].expand(*self.plane.shape, 3), self.plane - translation[..., :2]
        matrix = rotation[..., :2, :] - self.plane[..., None] * rotation[..., 2:, :]
        return matrix, self.plane * translation[..., 2:] - translation[..., :2]

    def missed(self, points: Float[Tensor, "frames 21 3"]) -> Float[Tensor, "frames 21"]:
        """Distance from points in space, in standard deviations; infinite behind the camera, NaN for missing ones."""
        rotation, translation = self._axes
        own = (rotation @ points[..., None])[..., 0] + translation
        away = own[..., :2] - self.plane
        if self.camera.kind == "pinhole":
            away = own[..., :2] / own[..., 2:].clamp_min(_MIN_DEPTH) - self.plane
            away = torch.where(own[..., 2:] > _MIN_DEPTH, away, torch.inf)
        away = torch.where(points.isfinite().all(-1, keepdim=True), away, torch.nan)
        return torch.where(self.weight > 0, self.weight * away.norm(dim=-1), torch.nan)

    def typical(self, points: Float[Tensor, "frames 21 3"]) -> Float[Tensor, "frames"]:
        """Median distance; infinite where too few points are known."""
        missed = self.missed(points)
        known = (~missed.isnan()).sum(-1)
        return torch.where(known >= _MIN_POINTS, missed.nanmedian(-1).values, torch.inf)

    def trust(self, points: Float[Tensor, "frames 21 3"]) -> Float[Tensor, "frames 21"]:
        """Square root of what each point counts (Geman and McClure); 1 where it cannot be told."""
        return (1 + (self.missed(points) / _GROSS_STD).square()).reciprocal().nan_to_num(1.0)


def _solved(rows: Sequence[ViewRows], weights: Sequence[Float[Tensor, "frames 21"]]) -> Float[Tensor, "frames 21 3"]:
    """Points in weighted linear least squares; NaN for those of fewer than two views."""
    like = rows[0].plane
    matrix, value = like.new_zeros(*like.shape[:2], 3, 3), like.new_zeros(*like.shape[:2], 3)
    count = like.new_zeros(like.shape[:2])
    for one, weight in zip(rows, weights, strict=True):
        own, right = one.equations()
        square = weight.square()[..., None]
        matrix = matrix + own.mT @ (square[..., None] * own)
        value = value + (own.mT @ (square * right)[..., None])[..., 0]
        count = count + (weight > 0)
    size = matrix.diagonal(dim1=-2, dim2=-1).sum(-1).clamp_min(torch.finfo(like.dtype).tiny)
    matrix = matrix + 1e-12 * size[..., None, None] * torch.eye(3).to(like)
    found = torch.linalg.solve_ex(matrix, value)[0]
    return torch.where((count >= 2)[..., None], found, torch.nan)
