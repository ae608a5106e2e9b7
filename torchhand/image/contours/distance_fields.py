"""Distance maps of silhouettes, which keep the directions of the boundary apart, and of points."""

import math

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.image.contours.boundaries import (
    Boundary,
    boundary_angle,
    boundary_points,
    boundary_sides,
    cut_out,
    shrunk,
)
from torchhand.image.contours.distance_maps import distance_map
from torchhand.image.contours.sampled_maps import DistanceField

__all__ = ["Boundary", "DistanceField", "boundary_field", "boundary_points", "channel_of", "point_field"]

_OVERLAP = 1.5  # half width of the directions in a channel, channels
_MARGIN = 0.35  # maps reach so far beyond the contour, shares of its box's diagonal
_MIN_MARGIN = 8  # map pixels


def channel_of(normals: Float[Tensor, "*batch 2"], channels: int) -> Int[Tensor, "*batch"]:
    """The channel of an oriented field whose middle direction is nearest to each normal."""
    if channels == 1:
        return torch.zeros(normals.shape[:-1], dtype=torch.long, device=normals.device)
    angle = torch.atan2(normals[..., 1], normals[..., 0]).nan_to_num()
    return (angle * (channels / (2 * math.pi))).round().long() % channels


def boundary_field(
    mask: Bool[Tensor, "height width"],
    *,
    pitch_px: int = 1,
    channels: int = 1,
    reach_px: float | None = None,
) -> DistanceField:
    """Signed distance from the boundary of a silhouette, holes included; the picture's edge is none.

    pitch_px: pixels of the picture that one of the map stands for; a coarse map is that of the silhouette shrunk.
    channels: 1, or as many directions of the outward normal as are kept apart, each with the boundary within 1.5 times
        its share of the circle: two sides of a finger are then never confused.
    reach_px: how far beyond the boundary's box the map goes, 8 map pixels or more; a third of its diagonal by default.
    """
    if pitch_px < 1 or channels < 1:
        raise ValueError(f"pitch_px, channels: expected 1 or more, got {pitch_px} and {channels}")
    pitch = float(pitch_px)
    grid, cut = cut_out(mask, multiple=pitch_px)
    if pitch_px > 1:
        grid = (shrunk(grid, pitch_px) > 0.5 * pitch_px**2 + 0.25).astype(np.uint8)
    sides = [np.nonzero(side) for side in boundary_sides(grid)]
    angles = [boundary_angle(grid, *side) for side in sides]
    offset = np.array(((cut.top // pitch_px,), (cut.left // pitch_px,)))
    places = [np.stack(side) + offset for side in sides]  # (row, column)
    start, stop = _extent(places, tuple(-(-size // pitch_px) for size in mask.shape), reach_px, pitch)
    marked = np.zeros((2, channels, *(stop - start)), dtype=bool)
    step = 2 * math.pi / channels
    middles = step * np.arange(channels)[:, None]
    for side, place, angle in zip(marked, places, angles, strict=True):
        near = np.abs(np.remainder(angle - middles + math.pi, 2 * math.pi) - math.pi) <= _OVERLAP * step
        channel, which = np.nonzero(near) if channels > 1 else (0, slice(None))
        y, x = place[:, which] - start[:, None]
        side[channel, y, x] = True
    return DistanceField(
        maps=_maps(marked, pitch).to(mask.device),
        origin_px=_origin(start, pitch, shift=0.5 * (pitch - 1)),
        pitch_px=pitch,
    )


def point_field(
    points_px: Float[Tensor, "points 2"], width: int, height: int, *, pitch_px: float = 1.0
) -> DistanceField:
    """Unsigned distance from points of a picture; with a pitch below 1 they keep their place within the pixel."""
    columns, rows = math.ceil(width / pitch_px), math.ceil(height / pitch_px)
    marked = np.zeros((1, 1, max(rows, 2), max(columns, 2)), dtype=bool)
    x, y = np.rint(points_px.detach().cpu().numpy().T / pitch_px).astype(int)
    inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
    marked[0, 0, y[inside], x[inside]] = True
    return DistanceField(maps=_maps(marked, pitch_px).to(points_px.device), origin_px=(0.0, 0.0), pitch_px=pitch_px)


def _extent(
    places: list[np.ndarray], size: tuple[int, ...], reach_px: float | None, pitch_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """First and last-but-one (row, column) of a map around places (2, n) within a picture of so many map pixels."""
    together, whole = np.concatenate(places, 1), np.maximum(size, 2)
    if not together.size:
        return np.zeros(2, dtype=int), whole
    first, last = together.min(1), together.max(1)
    reach = _MARGIN * math.hypot(*(last - first)) if reach_px is None else reach_px / pitch_px
    margin = _MIN_MARGIN + round(reach)
    return np.maximum(first - margin, 0), np.minimum(last + 1 + margin, whole)


def _origin(start: np.ndarray, pitch_px: float, shift: float = 0.0) -> tuple[float, float]:
    row, column = start.tolist()
    return column * pitch_px + shift, row * pitch_px + shift


def _maps(marked: np.ndarray, pitch_px: float) -> Float[Tensor, "sides channels height width"]:
    """Distances in px from what is marked."""
    maps = distance_map(torch.from_numpy(marked))
    if pitch_px != 1:
        maps *= pitch_px
    maps[~torch.from_numpy(marked.any((-2, -1)))] = pitch_px * math.hypot(*marked.shape[-2:])
    return maps
