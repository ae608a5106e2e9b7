"""Which part of a hand each square of a grid shows, for a hand that moves a little: only parts nearby are asked."""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit.open_hand.pixels import PixelGrid
from torchhand.image import dilate, square_kernel

_EVERY = 3  # squares from one that is asked at the start to the next, both ways
_AROUND = 2  # such steps that a part may move by

_EDGE, _CORNER, _AXIS, _LOW, _HIGH = slice(9, 12), 12, slice(13, 16), 16, 17


class NearestParts:
    """For every square within the silhouette the part that its ray meets first, as `raycast` finds it.

    The parts that a ray may meet are those that some ray nearby met at the start, hidden ones included; the start asks
    every third ray of a row and column.
    """

    def __init__(self, grid: PixelGrid, numbers: Float[Tensor, "37 18"]) -> None:
        """`numbers` are those of `quadric_numbers` at the start."""
        self._square = grid.is_inside.nonzero()[:, 0]
        rows, width = grid.size
        lattice = torch.arange(rows * width).reshape(rows, width)[::_EVERY, ::_EVERY]
        asked = lattice.flatten()
        every = _Rays(grid.origin[asked], grid.direction[asked], [torch.arange(len(asked))] * len(numbers))
        is_met = every.depths(numbers).isfinite().reshape(-1, *lattice.shape)
        wide = dilate(is_met, square_kernel(_AROUND)).flatten(1)
        row, column = self._square // width, self._square % width
        tall, broad = lattice.shape
        nearest = ((row + 1) // _EVERY).clamp_max(tall - 1) * broad + ((column + 1) // _EVERY).clamp_max(broad - 1)
        columns = [plane[nearest].nonzero()[:, 0] for plane in wide]
        self._rays = _Rays(grid.origin[self._square], grid.direction[self._square], columns)
        self._column = torch.cat(columns)
        counts = torch.tensor([len(column) for column in columns])
        self._part = torch.arange(len(columns)).repeat_interleave(counts)
        self._count = len(grid.value)

    def __call__(self, numbers: Float[Tensor, "37 18"]) -> Int[Tensor, "squares"]:
        """-1 where there is nothing, or where the silhouette does not reach."""
        depth = self._rays.depths(numbers)
        nearest = depth.new_full((len(self._square),), torch.inf).scatter_reduce_(0, self._column, depth, "amin")
        is_first = (depth == nearest[self._column]) & depth.isfinite()
        part = torch.full((self._count,), -1)
        part[self._square[self._column[is_first]]] = self._part[is_first]
        return part


class _Rays:
    """Products of rays' coordinates, by which a product with a part's numbers evaluates its quadric on its rays."""

    def __init__(
        self, origin: Float[Tensor, "rays 3"], direction: Float[Tensor, "rays 3"], columns: Sequence[Tensor]
    ) -> None:
        """`columns` tells the rays of every part, one part after the other."""
        self._is_pinhole = not bool(origin.any())  # all rays start at the frame's origin
        planes = [direction.T, _products(direction, direction)]
        if not self._is_pinhole:
            planes += [origin.T, _products(direction, origin), _products(origin, origin)]
        whole = torch.cat(planes)
        self._planes = [whole.index_select(1, own) for own in columns]
        self._part = torch.arange(len(columns)).repeat_interleave(torch.tensor([len(own) for own in columns]))

    def depths(self, numbers: Float[Tensor, "37 18"]) -> Float[Tensor, "pairs"]:
        """Of the first point of each part on its rays that is not cut off; infinite where there is none."""
        terms = self._terms(numbers)
        found = torch.cat([own @ planes for own, planes in zip(terms, self._planes, strict=True)], 1)
        corner, low, high = numbers[:, [_CORNER, _LOW, _HIGH]].T.index_select(1, self._part)
        quadratic, linear, rise = found[:3]
        constant, start = corner, torch.zeros_like(linear)
        if not self._is_pinhole:
            constant, start = corner + found[3], found[4]
        power = linear.square() - quadratic * constant
        root = power.clamp_min(0).sqrt()
        nearest = torch.full_like(linear, torch.inf)
        for depth in ((-linear - root) / quadratic, (root - linear) / quadratic):
            level = start + depth * rise
            is_kept = (depth > 0) & (level >= low) & (level <= high) & (power > 0)
            nearest = torch.where(is_kept, torch.minimum(depth, nearest), nearest)
        return nearest

    def _terms(self, numbers: Float[Tensor, "37 18"]) -> Float[Tensor, "37 terms planes"]:
        """What the planes are multiplied by: terms of the quadratic in a ray's depth (square, half the linear one) and
        the depth's part in the axis's level; for rays from anywhere the constants too, the corner left out."""
        upper, edge, axis = numbers[:, :9], numbers[:, _EDGE], numbers[:, _AXIS]
        terms = numbers.new_zeros(len(numbers), *((3, 12) if self._is_pinhole else (5, 33)))
        terms[:, 0, 3:12], terms[:, 1, :3], terms[:, 2, :3] = upper, edge, axis
        if not self._is_pinhole:
            terms[:, 1, 15:24], terms[:, 3, 24:], terms[:, 3, 12:15], terms[:, 4, 12:15] = upper, upper, 2 * edge, axis
        return terms


def _products(first: Float[Tensor, "rays 3"], second: Float[Tensor, "rays 3"]) -> Float[Tensor, "9 rays"]:
    return (first[:, :, None] * second[:, None, :]).flatten(1).T
