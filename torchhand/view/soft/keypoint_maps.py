"""Keypoints as pictures: a Gaussian about each, integrated over every pixel's area."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.precision import own_precision


@own_precision
def keypoint_maps(
    points_px: Float[Tensor, "*batch keypoints 2"], size: tuple[int, int], *, std_px: float = 2.0
) -> Float[Tensor, "*batch keypoints height width"]:
    """How much of a Gaussian about each point falls into each pixel; a map sums to 1 where all of it is in the picture.

    The integral over a pixel is exact, so that a map neither aliases nor loses its gradient however narrow it is. A
    point that is not finite has an empty map. size: width, height, px. std_px: standard deviation, px; above 0.
    """
    if not 0 < std_px < math.inf:
        raise ValueError(f"std_px: expected above 0 and finite, got {std_px}")
    is_there = points_px.isfinite().all(-1, keepdim=True)
    points = torch.where(is_there, points_px, 0.0)
    along = []
    for axis, count in enumerate(size):
        borders = torch.arange(count + 1, dtype=points.dtype, device=points.device) - 0.5
        below = torch.special.ndtr((borders - points[..., axis, None]) / std_px)
        along.append(below.diff(dim=-1))
    columns, rows = along
    return (rows * is_there)[..., :, None] * columns[..., None, :]
