"""Boundaries of silhouettes: their pixels on both sides, their direction, and their place between the pixels."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.image.contours.windows import Window

_BLUR_PX = 1.5  # standard deviation of the smoothing that gives a boundary its direction
_REACH = 10  # px: farther away nothing of a boundary is felt


@dataclass(frozen=True, kw_only=True)
class Boundary:
    """Points of a silhouette's boundary, between the pixels."""

    points_px: Float[Tensor, "points 2"]
    normals: Float[Tensor, "points 2"]
    """Outward unit normals."""

    def thinned(self, factor: int) -> "Boundary":
        """Every so manieth of the points, evenly over the boundary."""
        if factor == 1:
            return self
        return Boundary(points_px=self.points_px[::factor], normals=self.normals[::factor])


def boundary_points(mask: Bool[Tensor, "height width"], count: int) -> Boundary:
    """Up to `count` points spread over the boundary of a silhouette, between its pixels, float64.

    Each outermost pixel inside is moved along the gradient of the smoothed silhouette to where that is ½.
    """
    grid, window = cut_out(mask)
    within, _ = boundary_sides(grid)
    y, x = np.nonzero(within)
    if len(x) > count:
        chosen = np.linspace(0, len(x) - 1, count).round().astype(int)
        y, x = y[chosen], x[chosen]
    soft, slopes = _smoothed(grid)
    slope = np.stack([part[y, x] for part in slopes], -1)
    steepness = np.maximum(np.hypot(slope[:, 0], slope[:, 1]), 1e-6)
    normal = -slope / steepness[:, None]
    step = np.clip((soft[y, x] - 0.5) / steepness, -1.0, 1.5)
    points = np.stack((x + window.left, y + window.top), -1) + step[:, None] * normal
    return Boundary(
        points_px=torch.from_numpy(points).to(mask.device, torch.float64),
        normals=torch.from_numpy(normal).to(mask.device, torch.float64),
    )


def cut_out(mask: Bool[Tensor, "height width"], *, multiple: int = 1) -> tuple[np.ndarray, Window]:
    """A silhouette with all around it that its boundary depends on, uint8."""
    whole = mask.cpu().numpy().view(np.uint8)
    window = Window.around(whole, _REACH * multiple, multiple=multiple)
    return np.ascontiguousarray(whole[window.slices]), window


def boundary_sides(grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outermost pixels inside and innermost pixels outside, bool."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    return grid > cv2.erode(grid, cross), grid < cv2.dilate(grid, cross)


def boundary_angle(grid: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Direction of the outward normal at pixels near the boundary, radians."""
    _, (slope_x, slope_y) = _smoothed(grid)
    return np.arctan2(-slope_y[y, x], -slope_x[y, x])


def shrunk(grid: np.ndarray, pitch: int) -> np.ndarray:
    """How many pixels are set in each square of so many by so many; those beyond the picture's edge are as the last."""
    height, width = grid.shape
    padded = cv2.copyMakeBorder(grid, 0, -height % pitch, 0, -width % pitch, cv2.BORDER_REPLICATE)
    size = (padded.shape[1] // pitch, padded.shape[0] // pitch)
    return pitch**2 * cv2.resize(padded.astype(np.float32), size, interpolation=cv2.INTER_AREA)


def _smoothed(grid: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    soft = cv2.GaussianBlur(grid.astype(np.float32), (0, 0), _BLUR_PX)
    slopes = (cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=3, scale=0.125), cv2.Sobel(soft, cv2.CV_32F, 0, 1, scale=0.125))
    return soft, slopes
