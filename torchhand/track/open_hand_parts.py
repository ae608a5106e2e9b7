"""Which part of a hand each square of a grid shows, for a hand that moves a little: only parts nearby are asked."""

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.track.open_hand_pixels import PixelGrid

_AROUND = 6  # squares that a part may move by

_EDGE, _CORNER, _AXIS, _LOW, _HIGH = slice(9, 12), 12, slice(13, 16), 16, 17


class NearestParts:
    """For every square within the silhouette the part that its ray meets first, as `raycast` finds it.

    The parts that a ray may meet are those that it or a neighbour met at the start, hidden ones included.
    """

    def __init__(self, grid: PixelGrid, numbers: Float[Tensor, "37 18"]) -> None:
        """`numbers` are those of `quadric_numbers` at the start."""
        inside = grid.is_inside.nonzero()[:, 0]
        every = torch.arange(len(numbers)).repeat_interleave(len(inside))
        depth = _depths(
            numbers, every, *(rays[inside].repeat(len(numbers), 1) for rays in (grid.origin, grid.direction))
        )
        is_met = torch.zeros(len(numbers), len(grid.value), dtype=torch.uint8)
        is_met[:, inside] = depth.isfinite().reshape(len(numbers), -1).byte()
        kernel = np.ones((2 * _AROUND + 1,) * 2, np.uint8)
        wide = [cv2.dilate(plane.reshape(grid.size).numpy(), kernel).ravel() for plane in is_met]
        is_near = torch.from_numpy(np.stack(wide)).bool() & grid.is_inside
        self._part, self._square = is_near.nonzero().unbind(1)
        self._origin, self._direction = grid.origin[self._square], grid.direction[self._square]
        self._count = len(grid.value)

    def __call__(self, numbers: Float[Tensor, "37 18"]) -> Int[Tensor, "squares"]:
        """-1 where there is nothing, or where the silhouette does not reach."""
        depth = _depths(numbers, self._part, self._origin, self._direction)
        nearest = depth.new_full((self._count,), torch.inf).scatter_reduce_(0, self._square, depth, "amin")
        is_first = (depth == nearest[self._square]) & depth.isfinite()
        part = torch.full((self._count,), -1)
        part[self._square[is_first]] = self._part[is_first]
        return part


def _depths(
    numbers: Float[Tensor, "37 18"],
    part: Int[Tensor, "pairs"],
    origin: Float[Tensor, "pairs 3"],
    direction: Float[Tensor, "pairs 3"],
) -> Float[Tensor, "pairs"]:
    """Of the first point of a part on a ray that is not cut off; infinite where there is none."""
    own = numbers[part]
    upper, edge, axis = own[:, :9].unflatten(-1, (3, 3)), own[:, _EDGE], own[:, _AXIS]
    turned = (upper * direction[:, None, :]).sum(-1)
    base = (upper * origin[:, None, :]).sum(-1) + edge
    quadratic, linear = (turned * direction).sum(-1), (base * direction).sum(-1)
    constant = ((base + edge) * origin).sum(-1) + own[:, _CORNER]
    power = linear.square() - quadratic * constant
    root = power.clamp_min(0).sqrt()
    start, rise = (axis * origin).sum(-1), (axis * direction).sum(-1)
    nearest = torch.full_like(linear, torch.inf)
    for depth in ((-linear - root) / quadratic, (root - linear) / quadratic):
        level = start + depth * rise
        is_kept = (depth > 0) & (level >= own[:, _LOW]) & (level <= own[:, _HIGH]) & (power > 0)
        nearest = torch.where(is_kept, torch.minimum(depth, nearest), nearest)
    return nearest
