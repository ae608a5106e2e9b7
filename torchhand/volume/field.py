"""Signed distance from a hull's surface on a regular grid, read between its points with the gradient."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.devices import constant_tensor, read_back
from torchhand.image import distance_map
from torchhand.volume.octree import Octree

MARGIN = 0.01  # metres

_COLUMNS_AT_ONCE = 512
_STEPS_AT_ONCE = 4  # between two looks at how many are left

_NOTHING = 1e-24  # m²: keeps the slope of a length finite at zero


@dataclass(frozen=True, kw_only=True)
class HullField:
    """Distance in metres from the surface of the hull of each frame, negative inside."""

    values: Float[Tensor, "*batch nx ny nz"]
    """Distances at the centres of finest octants, float32; the grid's diagonal everywhere in a frame without hull."""
    origin: Float[Tensor, "*batch 3"]
    """Place of the first value, world frame, metres, float64: every frame has its own."""
    pitch: float
    """Distance between values, metres."""

    def sample(
        self, points_world: Float[Tensor, "*points 3"]
    ) -> tuple[Float[Tensor, "*values"], Float[Tensor, "*values 3"]]:
        """Distance at points (*batch, *more, 3) and its gradient (*batch, *more, 3), in the dtype of the points.

        Trilinear: continuous, with a gradient that jumps between cells. The value can also be differentiated by
        autograd. Outside the grid the distance from the grid is added to the value at its nearest point, so that what
        is outside is drawn back; that is never less than the true distance. Points that are not finite give NaN.

        Raises ValueError where the points' leading dimensions are not those of the field.
        """
        batch, size = self.values.shape[:-3], self.values.shape[-3:]
        lead = points_world.shape[: len(batch)]
        if lead != batch or points_world.ndim <= len(batch):
            raise ValueError(f"points_world: expected the shape ({batch}, ..., 3), got {tuple(points_world.shape)}")
        flat = points_world.reshape(*batch, -1, 3)
        # From here on x, y and z come first and the points last.
        place = ((flat - self.origin.to(flat)[..., None, :]) / self.pitch).movedim(-1, 0).contiguous()
        last = constant_tensor(tuple(size), place.dtype, place.device).reshape(3, *(1,) * (place.ndim - 1)) - 1
        clamped = place.clamp(torch.zeros_like(last), last)
        cell = torch.minimum(clamped.detach().nan_to_num().floor(), last - 1)
        x, y, z = clamped - cell
        corners = self._corners(cell)
        # Along z, then y, then x; each step keeps the slopes of the ones before.
        low, high = corners[:, :, 0], corners[:, :, 1]
        along_z = torch.stack((torch.lerp(low, high, z), high - low))  # value, slope in z; x; y
        low, high = along_z[:, :, 0], along_z[:, :, 1]
        along_y = torch.cat((torch.lerp(low, high, y), (high - low)[:1]))  # value, slope in z, in y; x
        low, high = along_y[:, 0], along_y[:, 1]
        value, slope_z, slope_y = torch.lerp(low, high, x)
        slopes = torch.stack(((high - low)[0], slope_y, slope_z)) / self.pitch
        outside = place - clamped
        beyond = outside * self.pitch
        length = (beyond.square().sum(0) + _NOTHING).sqrt()
        gradient = torch.where(outside == 0, slopes, beyond / length)
        shape = points_world.shape[:-1]
        return (value + length).reshape(shape), gradient.movedim(0, -1).reshape(*shape, 3)

    def _corners(self, cell: Float[Tensor, "3 *batch n"]) -> Float[Tensor, "2 2 2 *batch n"]:
        """Values around a cell, by x, y and z."""
        nx, ny, nz = self.values.shape[-3:]
        x, y, z = cell.long()
        index = (x * ny + y) * nz + z
        if self.values.ndim > 3:
            frames = torch.arange(self.origin[..., 0].numel(), device=index.device)
            index = index + (frames * (nx * ny * nz)).reshape(*self.values.shape[:-3], 1)
        steps = (0, 1, nz, nz + 1)
        around = constant_tensor((*steps, *(ny * nz + step for step in steps)), torch.long, index.device)
        around = around.reshape(8, *(1,) * index.ndim)
        found = self.values.reshape(-1).index_select(0, (around + index).reshape(-1))
        return found.to(cell.dtype).reshape(2, 2, 2, *index.shape)


def hull_field(
    octree: Octree,
    *,
    margin: float = MARGIN,
    surface: Literal["outer", "middle"] = "outer",
    within: tuple[Sequence[float], float] | None = None,
    exact_to: float = math.inf,
) -> HullField:
    """The field of every frame's hull, on a grid of finest octants around it.

    margin: metres around the hull that the grid reaches at least; at least one octant.
    surface: "outer", of all octants that make up the hull, which contains the object and is too large by about half the
        GRAY shell; or "middle", halfway from there to the BLACK octants, for the tests for inside and outside have the
        same margins. Where BLACK octants are farther away than usual, as in thin parts, the usual distance counts; one
        octant where there are none.

    Distances between the centres of octants are exact; half an octant is taken off, for the surface runs halfway
    between the centres on either side of it.

    Raises ValueError for a negative margin or another surface.
    """
    if surface not in ("outer", "middle"):
        raise ValueError(f"surface: expected 'outer' or 'middle', got {surface!r}")
    if not 0 <= margin < float("inf"):
        raise ValueError(f"margin: expected 0 or more metres, got {margin}")
    boxes = [_Box.of(octree, frame, within, has_inner=surface == "middle") for frame in range(octree.frame_count)]
    steps = math.ceil(exact_to / octree.leaf_side) if math.isfinite(exact_to) else None
    border = max(1, round(margin / octree.leaf_side))
    nx, ny, nz = (2 * border + max([1, *(box.filled.shape[axis] for box in boxes)]) for axis in range(3))
    size = (nx, ny, nz)
    device = octree.levels[0].states.device
    values = torch.empty(octree.frame_count, *size, device=device)
    first = torch.zeros(octree.frame_count, 3, dtype=torch.float64)
    for frame, box in enumerate(boxes):
        first[frame] = torch.tensor(box.start) - border
        cells = _signed(_padded(box.filled, size, border), steps)
        if box.inner is not None and box.filled.numel():
            cells = cells + 0.5 * _shell(cells, _padded(box.inner, size, border), steps)
        values[frame] = octree.leaf_side * cells
    corner = torch.tensor(octree.root.corner, dtype=torch.float64)
    origin = (first + 0.5) * octree.leaf_side + corner
    return HullField(
        values=values.reshape(*octree.batch, *size),
        origin=origin.to(device).reshape(*octree.batch, 3),
        pitch=octree.leaf_side,
    )


@dataclass(frozen=True, kw_only=True)
class _Box:
    """The finest cells that a frame's hull fills, in a box of them."""

    filled: Bool[Tensor, "nx ny nz"]
    inner: Bool[Tensor, "nx ny nz"] | None
    """The BLACK octants, where they are wanted."""
    start: tuple[int, ...]
    """The box's first cell."""

    @classmethod
    def of(cls, octree: Octree, frame: int, within: tuple[Sequence[float], float] | None, *, has_inner: bool) -> "_Box":
        filled, start = octree.occupancy(frame=frame)
        size = (filled.shape[0], filled.shape[1], filled.shape[2])
        inner = octree.occupancy_in(start, size, frame=frame, inner=True) if has_inner else None
        box = cls(filled=filled, inner=inner, start=start)
        return box if within is None else box._cut(octree, *within)

    def _cut(self, octree: Octree, centre: Sequence[float], half: float) -> "_Box":
        """What of it lies in a cube; all of it where nothing does."""
        kept: list[slice] = []
        for axis, count in enumerate(self.filled.shape):
            low = (centre[axis] - half - octree.root.corner[axis]) / octree.leaf_side - self.start[axis]
            begin, end = math.floor(low), math.ceil(low + 2 * half / octree.leaf_side)
            kept.append(slice(min(max(0, begin), count), max(0, end)))
        filled = self.filled[tuple(kept)]
        if not bool(filled.any()):
            return self
        start = tuple(own + part.start for own, part in zip(self.start, kept, strict=True))
        return _Box(filled=filled, inner=None if self.inner is None else self.inner[tuple(kept)], start=start)


def _padded(filled: Bool[Tensor, "_nx _ny _nz"], size: tuple[int, int, int], border: int) -> Bool[Tensor, "nx ny nz"]:
    """Cells in a larger box, from the border on."""
    whole = torch.zeros(size, dtype=torch.bool, device=filled.device)
    nx, ny, nz = filled.shape
    whole[border : border + nx, border : border + ny, border : border + nz] = filled
    return whole


def distance_grid(marked: Bool[Tensor, "nx ny nz"], *, steps: int | None = None) -> Float[Tensor, "nx ny nz"]:
    """Euclidean distance of every cell's centre from that of the nearest marked cell; infinite if there is none.

    steps: cells up to which distances are exact; larger ones may be too large. All are without it.

    Exact: distances within planes, then along the shortest axis the least of (x - x')² + those². Squares of distances
    are whole numbers, to which they are rounded.
    """
    first = min(range(3), key=lambda axis: marked.shape[axis])
    lowest = distance_map(marked.movedim(first, 0)).square_().round_().contiguous()
    if marked.device.type == "cpu":
        # Half the time that torch takes for so little, and a part at a time, which stays in the processor's cache and
        # needs no more steps than its own largest distance.
        columns = lowest.flatten(1).numpy()
        for start in range(0, columns.shape[1], _COLUMNS_AT_ONCE):
            own = np.ascontiguousarray(columns[:, start : start + _COLUMNS_AT_ONCE])
            least = own.copy()
            _min_along(own, least, np.minimum, steps)
            columns[:, start : start + _COLUMNS_AT_ONCE] = least
    else:
        _min_along(lowest.clone(), lowest, torch.minimum, steps)
    return lowest.sqrt_().movedim(0, first)


def _min_along(squared: Any, lowest: Any, minimum: Callable[..., object], steps: int | None) -> None:
    """The least over the first axis of its squared distance and what is there, written to `lowest`."""
    for step in range(1, len(squared) if steps is None else min(len(squared), steps + 1)):
        if step % _STEPS_AT_ONCE == 1 and step**2 >= float(lowest.max()):
            break
        moved = squared + step**2
        minimum(lowest[step:], moved[:-step], out=lowest[step:])
        minimum(lowest[:-step], moved[step:], out=lowest[:-step])


def _signed(filled: Bool[Tensor, "nx ny nz"], steps: int | None) -> Float[Tensor, "nx ny nz"]:
    """Distance from the surface of the marked cells, in cells, negative inside; the diagonal where there are none."""
    diagonal = torch.tensor(filled.shape, dtype=torch.float64).norm()
    signed = distance_grid(filled, steps=steps) - 0.5
    box = _box_around(filled)
    if filled[box].numel():
        signed[box] = torch.where(filled[box], 0.5 - distance_grid(~filled[box]), signed[box])
    return signed.clamp_max_(float(diagonal))


def _box_around(filled: Bool[Tensor, "nx ny nz"]) -> tuple[slice, ...]:
    """The marked cells and one more on every side, where there are more: what is nearest to them is among these."""
    cells, kept = read_back(filled), []
    for axis, count in enumerate(cells.shape):
        places = np.flatnonzero(np.any(cells, axis=tuple(other for other in range(3) if other != axis)))
        kept.append(slice(max(0, int(places[0]) - 1), min(count, int(places[-1]) + 2)) if len(places) else slice(0))
    return tuple(kept)


def _shell(
    outer: Float[Tensor, "nx ny nz"], black: Bool[Tensor, "nx ny nz"], steps: int | None
) -> Float[Tensor, "nx ny nz"] | Float[Tensor, ""]:
    """Cells between the outer surface and the BLACK octants, at most as many as usual along the surface."""
    if not bool(black.any()):
        return torch.ones((), device=outer.device)
    shell = _signed(black, steps) - outer
    return torch.minimum(shell, shell[(outer < 0) & (outer > -1)].median())
