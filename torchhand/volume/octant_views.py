"""The pixels that octants may cover in each picture, and what the silhouettes say about them.

An octant's projection is bounded by a rectangle of whole pixels. The corners of the octant lie in a box along the
camera's axes; the extremes of x / z over that box are met at its corners. The box of a child lies within that of its
parent, hence so does its rectangle: what is certain for an octant is certain for all that it divides into, and carving
level by level finds the same hull as testing every finest octant. Rounding in float32 is covered by a margin that
shrinks from level to level.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.volume.cube import RootCube
from torchhand.volume.silhouettes import LensCorrection, SumTables, sum_tables

_ROUNDING = 1e-5  # of the picture's size per level: what float32 may get wrong, with room to spare
_NEAR = 0.01  # octants nearer to the camera's plane than this share of the root cube are not projected
_NEAR_ROUNDING = 1e-3  # of that, per level


@dataclass(frozen=True, kw_only=True)
class Verdicts:
    """What every silhouette says about every octant; where it is neither in nor out, it is ON_BORDER."""

    is_out: Bool[Tensor, "views octants"]
    """Whether all pixels that the octant may cover are background."""
    is_in: Bool[Tensor, "views octants"]
    """Whether all pixels that the octant may cover are object."""
    is_unseen: Bool[Tensor, "views octants"]
    """Whether all these pixels lie outside the picture, or the octant behind the camera, or the view is missing in the
    frame."""
    is_bare: Bool[Tensor, "views octants"]
    """Whether no pixel of the octant is object: out, unseen, or half outside the picture with nothing in the other
    half."""


@dataclass(frozen=True, kw_only=True)
class _Level:
    """What octants of one level have in common, as (axes, views, 1); x and y in px times depth."""

    matrix: Float[Tensor, "axes_views 3"]
    """Map from cells to camera coordinates, x and y of all views first, then z."""
    reach: Float[Tensor, "2 views 1"]
    reach_z: Float[Tensor, "views 1"]
    before: Float[Tensor, "2 views 1"]
    """Turns the least coordinate, px, into the first row or column of a sum table within the rectangle."""
    after: Float[Tensor, "2 views 1"]
    """Turns the largest one into the first beyond the rectangle."""
    cut_below: Float[Tensor, "views 1"]
    """Octants nearer than this are not projected."""
    behind_below: Float[Tensor, "views 1"]


class OctantViews:
    """All views of octants of a root cube; computes in float32.

    margin_px: pixels by which every rectangle is widened on all sides; by one more behind a lens, whose pictures are
        corrected to the nearest pixel.
    levels: the finest level that will be asked for.
    """

    def __init__(
        self, cameras: Sequence[Camera], root: RootCube, *, margin_px: int, levels: int, device: torch.device
    ) -> None:
        lenses = [LensCorrection(camera, device) if camera.has_distortion else None for camera in cameras]
        self._lenses, self._shown = lenses, _shown(cameras, lenses, device)
        self._finest, self._device = levels, device
        margin = torch.tensor([margin_px + (lens is not None) for lens in lenses], dtype=torch.float64)
        exact = [camera.to(dtype=torch.float64, device="cpu") for camera in cameras]
        for camera in exact:
            if camera.rotation.ndim != 2:
                raise ValueError(f"cameras: expected single cameras, got a batch {tuple(camera.rotation.shape[:-2])}")
        self._side, self._margin = root.side, margin[:, None]
        self._sizes = torch.tensor([(c.width, c.height) for c in cameras], dtype=torch.float64).T[..., None]
        self._middle = torch.stack([camera.intrinsics[:2, 2] for camera in exact], -1)[..., None]
        # An orthographic camera sees everything at the same depth.
        linear, self._near = torch.eye(3, dtype=torch.float64).repeat(len(exact), 1, 1), []
        matrix, origin = [], []
        for camera, own in zip(exact, linear, strict=True):
            own[:2, :2] = camera.intrinsics[:2, :2]
            own[2, 2] = float(camera.kind == "pinhole")
            matrix.append(own @ camera.rotation)
            origin.append(own @ camera.translation)
            origin[-1][2] += float(camera.kind == "orthographic")
            self._near.append(_NEAR * root.side if camera.kind == "pinhole" else 0.5)
        self._matrix, self._origin = torch.stack(matrix, 1), torch.stack(origin, 1)  # (axes, views, ...)
        sizes = self._sizes.to(device, torch.float32)
        self._first, self._last = torch.zeros_like(sizes), sizes + 1  # columns and rows of the framed pictures
        self._ends = (sizes + 1).int()  # of the pictures in them
        self._levels = [self._constants(level, 1 + levels - level) for level in range(levels + 1)]
        self._place(root)

    def moved(self, root: RootCube) -> "OctantViews":
        """The same views of another cube of the same size."""
        views = copy.copy(self)
        views._place(root)
        return views

    def _place(self, root: RootCube) -> None:
        start = self._matrix @ torch.tensor(root.corner, dtype=torch.float64) + self._origin
        depth = start[2] + root.side * self._matrix[2].clamp_max(0).sum(-1)  # of the nearest corner
        self._is_in_front = bool((depth > 2 * torch.tensor(self._near, dtype=torch.float64)).all())
        halves = 0.5 * root.side * self._matrix.sum(-1).flatten()
        fractions = 0.5 ** torch.arange(self._finest + 1, dtype=torch.float64)
        middles = torch.addcmul(start.flatten(), fractions[:, None], halves)  # of each level's first octant
        self._starts = middles.to(self._device, torch.float32)[..., None]

    def _constants(self, level: int, finer: int) -> _Level:
        matrix = self._side / 2**level * self._matrix
        reach = 0.5 * matrix.abs().sum(-1, keepdim=True)
        rounding = _ROUNDING * finer * self._sizes.amax(0)
        near = torch.tensor(self._near, dtype=torch.float64)[:, None]
        values = {
            "matrix": matrix.flatten(0, 1),
            "reach": reach[:2],
            "reach_z": reach[2],
            # The pixel of x is floor(x + ½); the table's first column is that of the pixel at -1.
            "before": self._middle + 0.5 + 1 - self._margin - rounding,
            "after": self._middle + 0.5 + 2 + self._margin + rounding,
            "cut_below": near * (1 + _NEAR_ROUNDING * finer),
            "behind_below": near * (1 - _NEAR_ROUNDING * finer),
        }
        return _Level(**{name: value.to(self._device, torch.float32).contiguous() for name, value in values.items()})

    def tables(self, masks: Sequence[Bool[Tensor, "frames _height _width"]]) -> SumTables:
        """Tables of the silhouettes, one per camera, freed from the lens."""
        pairs = zip(masks, self._lenses, strict=True)
        return sum_tables([mask if lens is None else lens(mask) for mask, lens in pairs])

    def verdicts(
        self,
        cells: Float[Tensor, "3 octants"],
        level: int,
        silhouettes: SumTables,
        frames: Int[Tensor, "octants"] | None,
        is_there: Bool[Tensor, "views frames"] | None,
    ) -> Verdicts:
        """What the silhouettes of their frames say about octants.

        cells: places of the octants in the grid of the level.
        silhouettes: `tables` of all frames; frames: the one of each octant, None where there is only one.
        is_there: the views that are not missing; None where none is.
        """
        at = self._levels[level]
        place = torch.addmm(self._starts[level], at.matrix, cells).reshape(3, -1, cells.shape[1])
        front, back = place[2] - at.reach_z, place[2] + at.reach_z
        is_cut = is_behind = None
        if not self._is_in_front:
            is_cut, is_behind = front < at.cut_below, back < at.behind_below
            front = torch.maximum(front, 0.5 * at.cut_below, out=front)
            back = torch.maximum(back, 0.5 * at.cut_below, out=back)
        near, far = front.reciprocal_(), back.reciprocal_()
        low, high = place[:2] - at.reach, place[:2].add_(at.reach)
        low = torch.minimum(low * near, low.mul_(far)).add_(at.before).floor_()
        high = torch.maximum(high * near, high.mul_(far)).add_(at.after).floor_()
        begin = torch.clamp(low, self._first, self._last, out=low).int()
        beyond = torch.clamp(high, self._first + 1, self._last + 1, out=high).int()
        width, height = beyond - begin
        area = width.mul_(height)
        marked = silhouettes.counts(silhouettes.places(begin, beyond), frames)
        shown = self._number_shown(begin, beyond)
        is_bare, is_in, is_unseen = marked == 0, marked == area, shown == 0
        is_out = (shown == area).logical_and_(is_bare)
        if is_cut is not None and is_behind is not None:
            is_in &= ~is_cut
            is_out &= ~is_cut
            is_unseen = (is_unseen & ~is_cut) | is_behind
            # Of an octant across the camera's plane nothing is known; undivided it counts as not looked at.
            is_bare = is_bare | is_cut if level == self._finest else (is_bare & ~is_cut) | is_behind
        if is_there is not None:
            is_missing = ~is_there if frames is None else ~is_there.index_select(1, frames)
            is_in, is_out = is_in & ~is_missing, is_out & ~is_missing
            is_unseen, is_bare = is_unseen | is_missing, is_bare | is_missing
        return Verdicts(is_out=is_out, is_in=is_in, is_unseen=is_unseen, is_bare=is_bare)

    def _number_shown(
        self, begin: Int[Tensor, "2 views n"], beyond: Int[Tensor, "2 views n"]
    ) -> Int[Tensor, "views n"]:
        """Pixels of rectangles in the framed pictures that show something: not the frame, nor what the lens hides."""
        if self._shown is not None:
            return self._shown.counts(self._shown.places(begin, beyond), None)
        first = torch.ones_like(self._ends)
        width, height = torch.clamp(beyond, first, self._ends).sub_(torch.clamp(begin, first, self._ends))
        return width.mul_(height)


def _shown(
    cameras: Sequence[Camera], lenses: Sequence[LensCorrection | None], device: torch.device
) -> SumTables | None:
    """Tables of the pixels that show something; None where all of all pictures do."""
    if all(lens is None for lens in lenses):
        return None
    whole = [torch.ones(camera.height, camera.width, dtype=torch.bool, device=device) for camera in cameras]
    masks = [mask if lens is None else lens.is_shown for mask, lens in zip(whole, lenses, strict=True)]
    return sum_tables([mask[None] for mask in masks])
