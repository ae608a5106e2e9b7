"""Dark lines of a picture, between its pixels: where fingers touch or hide each other (Ouhaddi and Horain 1998, 7.3).

The paper seeks inner contours as thalwegs, valleys of the grey levels taken as a relief, since operators for edges
answer twice, on both sides of such a line. Its operator is not printed; this is the usual one (Steger 1998): the
Hessian of the smoothed picture, its largest eigenvalue and where the slope along its eigenvector is zero.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.image.contours.distance_maps import depth_map
from torchhand.image.operations import label_pieces

_INSIDE = 0.52  # the lowest place may lie this far from the pixel's centre along x and y: half, and rounding
_REACH_SIGMAS = 4.0  # of the filters
_HEAVY_SIGMAS = 3.0  # places so near to the region's rim are told by the rim
_SIGMA_PX = 1.6  # standard deviation of the smoothing; a line of half width w needs w / √3 or more
_LOW = 3.0  # least σ² × second derivative across the line, grey levels, of places that are linked to a stronger one
_HIGH = 7.0  # strength at which a line begins
_MIN_POINTS = 8  # pixels of the shortest line
_STEEPEST = 0.5  # largest |slope across the line| · σ of a place over its strength: edges are steep, valleys level
VALLEY_REACH_PX = math.ceil(_REACH_SIGMAS * _SIGMA_PX) + 1
"""How far around a region the picture matters to the valleys within it, px."""


@dataclass(frozen=True, kw_only=True)
class Valleys:
    """Places on dark lines, float64; one per pixel that a line crosses."""

    points_px: Float[Tensor, "points 2"]
    """Points (x, y) of the lines, between the pixels."""
    directions: Float[Tensor, "points 2"]
    """Unit, across the line; its sign means nothing."""
    strength: Float[Tensor, "points"]
    """σ² × second derivative across the line, grey levels."""


def find_valleys(
    grey: Float[Tensor, "height width"],
    *,
    within: Bool[Tensor, "height width"] | None = None,
) -> Valleys:
    """Dark lines of a picture in grey levels (0 to 255).

    A pixel is on a valley if along the eigenvector v of its Hessian's largest eigenvalue λ > 0 the slope vanishes
    within the pixel: t = -(∇I · v) / λ, |t v_x| and |t v_y| at most half. That pixel's place is its centre plus t v.
    Strength is σ² λ; lines are followed from places above 7 grey levels to all linked ones above 3 and dropped
    where shorter than 8 pixels.

    within: only lines inside this region (the hand) and clear of its rim, where the background makes valleys of its
    own: what lies beyond is first replaced by the region's nearest grey level.
    """
    picture = grey.detach().cpu().numpy().astype(np.float32)
    inside = np.ones(picture.shape, dtype=bool)
    if within is not None:
        region = within.cpu().numpy()
        picture = _extended(picture, region)
        depth = depth_map(torch.from_numpy(region)).numpy()
        inside = depth > _HEAVY_SIGMAS * _SIGMA_PX * 0.5
    slopes, (xx, xy, yy) = _derivatives(picture)
    half, mean = 0.5 * (xx - yy), 0.5 * (xx + yy)
    largest = mean + np.hypot(half, xy)
    strength = _SIGMA_PX**2 * largest
    y, x = np.nonzero((strength >= _LOW) & inside)
    angle = 0.5 * np.arctan2(xy[y, x], half[y, x])
    across = np.stack((np.cos(angle), np.sin(angle)), -1)
    slope = slopes[0][y, x] * across[:, 0] + slopes[1][y, x] * across[:, 1]
    shift = -(slope / largest[y, x])[:, None] * across
    keep = (np.abs(shift) <= _INSIDE).all(1)
    keep &= np.abs(slope) * _SIGMA_PX <= _STEEPEST * strength[y, x]
    y, x, across, shift = y[keep], x[keep], across[keep], shift[keep]
    linked = _linked(y, x, strength)
    y, x, across, shift = y[linked], x[linked], across[linked], shift[linked]
    found = (np.stack((x, y), -1) + shift, across, strength[y, x])
    points, directions, strengths = (torch.from_numpy(part).to(grey.device, torch.float64) for part in found)
    return Valleys(points_px=points, directions=directions, strength=strengths)


def _derivatives(
    picture: np.ndarray,
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Slopes and second derivatives of the picture smoothed by a Gaussian: separable, exact derivatives of it."""
    reach = math.ceil(_REACH_SIGMAS * _SIGMA_PX)
    t = np.arange(-reach, reach + 1, dtype=np.float64)
    bell = np.exp(-0.5 * (t / _SIGMA_PX) ** 2)
    bell /= bell.sum()
    first = t * bell  # correlation: the smoothed picture's slope is Σ t bell I / Σ t² bell
    first /= (t * first).sum()
    second = (t**2 - (t**2 * bell).sum()) * bell
    second *= 2 / (t**2 * second).sum()

    def filtered(along_x: np.ndarray, along_y: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(picture, cv2.CV_32F, along_x, along_y, borderType=cv2.BORDER_REPLICATE)

    slopes = (filtered(first, bell), filtered(bell, first))
    return slopes, (filtered(second, bell), filtered(first, first), filtered(bell, second))


def _extended(picture: np.ndarray, region: np.ndarray) -> np.ndarray:
    """The picture with every pixel beyond the region replaced by the region's nearest."""
    if not region.any() or region.all():
        return picture
    outside = np.logical_not(region).astype(np.uint8)
    _, label = cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    label = np.asarray(label, dtype=np.int64)
    level = np.zeros(int(label.max()) + 1, dtype=picture.dtype)
    level[label[region]] = picture[region]
    return np.where(region, picture, level[label])


def _linked(y: np.ndarray, x: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Which places belong to a line that is strong somewhere and long enough."""
    canvas = np.zeros(strength.shape, dtype=bool)
    canvas[y, x] = True
    pieces = label_pieces(torch.from_numpy(canvas))
    own = pieces.labels.numpy()[y, x] - 1
    peak = np.zeros(len(pieces.areas))
    np.maximum.at(peak, own, strength[y, x])
    good = (peak >= _HIGH) & (pieces.areas.numpy() >= _MIN_POINTS)
    return good[own]
