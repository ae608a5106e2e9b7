"""Distance maps that are read between their pixels, with the gradient; those of silhouettes keep directions apart."""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.image.distance_maps import distance_map

_BLUR_PX = 1.5  # standard deviation of the smoothing that gives a boundary its direction
_OVERLAP = 1.5  # half width of the directions in a channel, channels
_MARGIN = 0.35  # maps reach so far beyond the contour, shares of its box's diagonal
_NOTHING = 1e-24  # px²: keeps the slope of a length finite at zero
_LEAST_MARGIN = 8  # map pixels


@dataclass(frozen=True, kw_only=True)
class Boundary:
    """Points of a silhouette's boundary, between the pixels."""

    points_px: Float[Tensor, "points 2"]
    normals: Float[Tensor, "points 2"]
    """Unit, outward."""


@dataclass(frozen=True, kw_only=True)
class DistanceField:
    """Exact distance maps of one picture, sampled bilinearly.

    With `beyond` the field is signed: `within` holds the distances from the outermost pixels inside a boundary,
    `beyond` those from the innermost outside it. Between the two the distance from the boundary runs linearly through
    zero, which a single map, folded there, cannot give: a boundary is found to a small part of a pixel. Far away it is
    positive outside and negative inside.
    """

    within: Float[Tensor, "channels height width"]
    """Distances from marked pixels, in px of the picture; the map's diagonal where a channel has none."""
    beyond: Float[Tensor, "channels height width"] | None
    origin_px: tuple[float, float]
    """Place (x, y) of the first map pixel's centre in the picture."""
    pitch_px: float
    """Pixels of the picture per pixel of the map."""

    @property
    def channels(self) -> int:
        return self.within.shape[0]

    @cached_property
    def _corners(self) -> Float[Tensor, "cells 4 sides"]:
        """The four corners of every cell side by side, so that one look-up reads them all."""
        maps = [self.within] if self.beyond is None else [self.within, self.beyond]
        with torch.inference_mode(False):  # kept for callers in any mode
            cells = [torch.stack((m[:, :-1, :-1], m[:, :-1, 1:], m[:, 1:, :-1], m[:, 1:, 1:]), -1) for m in maps]
            return torch.stack(cells, -1).flatten(0, 2).contiguous()

    def sample(
        self, points_px: Float[Tensor, "*batch 2"], channel: Int[Tensor, "*batch"] | None = None
    ) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch 2"]]:
        """Distance in px at points (x, y) of the picture, and its gradient; in the dtype of the points.

        channel: of every point; the first where it is None. Beyond the map's edge the distance at the nearest point of
        the edge grows with the distance from there, so that what is outside is drawn back. The value can also be
        differentiated by autograd. Points that are not finite give NaN.
        """
        _, height, width = self.within.shape
        place = (points_px - points_px.new_tensor(self.origin_px)) / self.pitch_px
        last = place.new_tensor((width - 1, height - 1))
        held = torch.minimum(place.clamp_min(0), last)
        cell = torch.minimum(held.detach().nan_to_num().floor(), last - 1)
        share = held - cell
        column, row = cell.long().unbind(-1)
        index = row * (width - 1) + column
        if channel is not None:
            index = index + channel * ((height - 1) * (width - 1))
        corners = self._corners.index_select(0, index.reshape(-1)).to(points_px.dtype)
        corners = corners.reshape(*index.shape, 4, -1)
        a, b, c, d = corners.unbind(-2)
        x, y = share[..., :1], share[..., 1:]
        top, bottom = a + x * (b - a), c + x * (d - c)
        values = top + y * (bottom - top)
        slope_x = (b - a) + y * ((d - c) - (b - a))
        slopes = torch.stack((slope_x, bottom - top), -1)  # (*batch, sides, 2)
        if self.beyond is None:
            value, slope = values[..., 0], slopes[..., 0, :]
        else:
            half = 0.5 * self.pitch_px
            is_outside = values[..., 0] > values[..., 1]
            value = torch.where(is_outside, values[..., 0] - half, half - values[..., 1])
            slope = torch.where(is_outside[..., None], slopes[..., 0, :], -slopes[..., 1, :])
        outside = place - held
        is_held = outside == 0
        gradient = torch.where(is_held, slope / self.pitch_px, 0.0)
        beyond = outside * self.pitch_px
        length = (beyond.square().sum(-1) + _NOTHING).sqrt()
        away = torch.where(value < 0, -1.0, 1.0).to(value)
        return value + away * length, gradient + (away / length)[..., None] * beyond


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
    ignored: Bool[Tensor, "height width"] | None = None,
) -> DistanceField:
    """Signed distance from the boundary of a silhouette, holes included; the picture's edge is none.

    pitch_px: pixels of the picture that one of the map stands for; a coarse map is that of the silhouette shrunk.
    channels: 1, or as many directions of the outward normal as are kept apart, each with the boundary within 1.5 times
        its share of the circle: two sides of a finger are then never confused.
    ignored: pixels whose boundary does not count.
    """
    if pitch_px < 1 or channels < 1:
        raise ValueError(f"pitch_px, channels: expected 1 or more, got {pitch_px} and {channels}")
    grid, hidden = mask.cpu().numpy().astype(np.uint8), None if ignored is None else ignored.cpu().numpy()
    if pitch_px > 1:
        grid = (_shrunk(grid.astype(np.float32), pitch_px) > 0.5).astype(np.uint8)
        hidden = None if hidden is None else _shrunk(hidden.astype(np.float32), pitch_px) > 0
    sides = _sides(grid, hidden)
    left, top, right, bottom = _window(sides[0] | sides[1])
    angle = _direction(grid)[..., top:bottom, left:right]
    maps = []
    for side in sides:
        cut = side[top:bottom, left:right]
        marked = np.zeros((channels, *cut.shape), dtype=bool)
        if channels == 1:
            marked[0] = cut
        else:
            y, x = np.nonzero(cut)
            step = 2 * math.pi / channels
            for k in range(channels):
                turned = np.remainder(angle[y, x] - k * step + math.pi, 2 * math.pi) - math.pi
                near = np.abs(turned) <= _OVERLAP * step
                marked[k, y[near], x[near]] = True
        maps.append(_finite(pitch_px * distance_map(torch.from_numpy(marked)).to(mask.device), float(pitch_px)))
    shift = 0.5 * (pitch_px - 1)
    return DistanceField(
        within=maps[0],
        beyond=maps[1],
        origin_px=(left * pitch_px + shift, top * pitch_px + shift),
        pitch_px=float(pitch_px),
    )


def point_field(
    points_px: Float[Tensor, "points 2"], width: int, height: int, *, pitch_px: float = 1.0
) -> DistanceField:
    """Unsigned distance from points of a picture; with a pitch below 1 they keep their place within the pixel."""
    columns, rows = math.ceil(width / pitch_px), math.ceil(height / pitch_px)
    marked = torch.zeros(max(rows, 2), max(columns, 2), dtype=torch.bool, device=points_px.device)
    place = (points_px / pitch_px).round().long()
    inside = (place >= 0).all(-1) & (place[:, 0] < columns) & (place[:, 1] < rows)
    marked[place[inside, 1], place[inside, 0]] = True
    within = _finite(pitch_px * distance_map(marked)[None], pitch_px)
    return DistanceField(within=within, beyond=None, origin_px=(0.0, 0.0), pitch_px=pitch_px)


def boundary_points(
    mask: Bool[Tensor, "height width"], count: int, *, ignored: Bool[Tensor, "height width"] | None = None
) -> Boundary:
    """At most `count` points spread over the boundary of a silhouette, between its pixels, float64.

    Each outermost pixel inside is moved along the gradient of the smoothed silhouette to where that is ½.
    """
    grid = mask.cpu().numpy().astype(np.uint8)
    within, _ = _sides(grid, None if ignored is None else ignored.cpu().numpy())
    y, x = np.nonzero(within)
    if len(x) > count:
        chosen = np.linspace(0, len(x) - 1, count).round().astype(int)
        y, x = y[chosen], x[chosen]
    soft, (slope_x, slope_y) = _smoothed(grid)
    steepness = np.maximum(np.hypot(slope_x[y, x], slope_y[y, x]), 1e-6)
    normal = -np.stack((slope_x[y, x], slope_y[y, x]), -1) / steepness[:, None]
    step = np.clip((soft[y, x] - 0.5) / steepness, -1.0, 1.5)
    points = np.stack((x, y), -1) + step[:, None] * normal
    return Boundary(
        points_px=torch.from_numpy(points).to(mask.device, torch.float64),
        normals=torch.from_numpy(normal).to(mask.device, torch.float64),
    )


def _finite(maps: Tensor, pitch_px: float) -> Tensor:
    return maps.clamp_max(pitch_px * math.hypot(*maps.shape[-2:]))


def _sides(grid: np.ndarray, hidden: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Outermost pixels inside and innermost pixels outside."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    within = (grid > 0) & (cv2.erode(grid, cross) == 0)
    beyond = (grid == 0) & (cv2.dilate(grid, cross) > 0)
    if hidden is None:
        return within, beyond
    wide = cv2.dilate(hidden.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return within & ~wide, beyond & ~wide


def _smoothed(grid: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    soft = cv2.GaussianBlur(grid.astype(np.float32), (0, 0), _BLUR_PX)
    slopes = (cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=3, scale=0.125), cv2.Sobel(soft, cv2.CV_32F, 0, 1, scale=0.125))
    return soft, slopes


def _direction(grid: np.ndarray) -> np.ndarray:
    """Angle of the outward normal at every pixel near the boundary."""
    _, (slope_x, slope_y) = _smoothed(grid)
    return np.arctan2(-slope_y, -slope_x)


def _shrunk(picture: np.ndarray, pitch: int) -> np.ndarray:
    """Means of squares of pixels; those cut by the picture's edge are of what there is."""
    height, width = picture.shape
    padded = np.pad(picture, ((0, -height % pitch), (0, -width % pitch)), mode="edge")
    return padded.reshape(padded.shape[0] // pitch, pitch, -1, pitch).mean((1, 3))


def _window(marked: np.ndarray) -> tuple[int, int, int, int]:
    """left, top, right, bottom (exclusive) of what is marked and a margin, within the picture; all of it if nothing."""
    height, width = marked.shape
    rows, columns = np.flatnonzero(marked.any(1)), np.flatnonzero(marked.any(0))
    if not len(rows):
        return 0, 0, max(width, 2), max(height, 2)
    margin = _LEAST_MARGIN + round(_MARGIN * math.hypot(rows[-1] - rows[0], columns[-1] - columns[0]))
    left, right = max(0, columns[0] - margin), min(width, columns[-1] + 1 + margin)
    top, bottom = max(0, rows[0] - margin), min(height, rows[-1] + 1 + margin)
    return int(left), int(top), int(right), int(bottom)
