"""The octree of a hull, level by level (Ueda et al. 2003, section 3.1): black inside, white outside, grey across."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchhand.volume.cube import RootCube

WHITE, GRAY, BLACK, UNKNOWN = 0, 1, 2, 3
"""States of an octant: outside the hull, across its boundary, inside it, not seen by enough views to tell."""


@dataclass(frozen=True, kw_only=True)
class OctreeLevel:
    """The octants of one level that were looked at, those of all frames in one row: the root, or children of GRAY ones.

    The eight children of an octant follow each other, and children come in the order of their parents.
    """

    level: int
    """The root cube's side is divided by 2**level."""
    cells: Int[Tensor, "octants 3"]
    """Place (x, y, z) in the grid of the level, 0 to 2**level - 1, int16."""
    states: UInt8[Tensor, "octants"]
    """WHITE, GRAY, BLACK or UNKNOWN."""
    frames: Int[Tensor, "octants"]
    """The frame of the flattened batch that each belongs to, int32."""


@dataclass(frozen=True, kw_only=True)
class Leaves:
    """Cubes that make up a hull, those of all frames in one row."""

    centres: Float[Tensor, "leaves 3"]
    """Centres in the world frame, metres."""
    sides: Float[Tensor, "leaves"]
    """Sides of the octants, metres."""
    states: UInt8[Tensor, "leaves"]
    frames: Int[Tensor, "leaves"]


@dataclass(frozen=True, kw_only=True)
class Octree:
    """Hulls of a batch of frames.

    BLACK octants of any level and GRAY ones of the last are the hull: they contain the object. UNKNOWN ones may contain
    more of it, where too few cameras look.
    """

    root: RootCube
    batch: tuple[int, ...]
    """Leading dimensions of the silhouettes."""
    levels: tuple[OctreeLevel, ...]
    """Levels from the root (level 0) to the finest."""

    @property
    def level(self) -> int:
        """The finest level; less than what was asked for where a limit on the number of octants ended the carving."""
        return len(self.levels) - 1

    @property
    def leaf_side(self) -> float:
        """Side of the finest octants, metres."""
        return self.root.side / 2**self.level

    @property
    def frame_count(self) -> int:
        return int(torch.Size(self.batch).numel())

    def leaves(self, *, frame: int | None = None, unknown: bool = False, dtype: torch.dtype = torch.float32) -> Leaves:
        """The BLACK octants and the GRAY ones of the last level, coarse ones first.

        frame: index into the flattened batch; all frames where it is None.
        unknown: the UNKNOWN octants as well.
        """
        kept = [self._leaves_of(octants, frame, unknown) for octants in self.levels]
        cells = torch.cat([octants.cells[at] for octants, at in zip(self.levels, kept, strict=True)]).to(dtype)
        sides = torch.cat(
            [
                torch.full((len(at),), self.root.side / 2**octants.level, dtype=dtype, device=cells.device)
                for octants, at in zip(self.levels, kept, strict=True)
            ]
        )
        corner = torch.tensor(self.root.corner, dtype=dtype, device=cells.device)
        return Leaves(
            centres=(cells + 0.5) * sides[:, None] + corner,
            sides=sides,
            states=torch.cat([octants.states[at] for octants, at in zip(self.levels, kept, strict=True)]),
            frames=torch.cat([octants.frames[at] for octants, at in zip(self.levels, kept, strict=True)]),
        )

    def _leaves_of(self, octants: OctreeLevel, frame: int | None, unknown: bool) -> Int[Tensor, "leaves"]:
        is_leaf = octants.states == BLACK
        if octants.level == self.level:
            is_leaf |= octants.states == GRAY
        if unknown:
            is_leaf |= octants.states == UNKNOWN
        if frame is not None:
            if not 0 <= frame < self.frame_count:
                raise ValueError(f"frame: expected 0 to {self.frame_count - 1}, got {frame}")
            if self.frame_count > 1:
                is_leaf &= octants.frames == frame
        return places_of(is_leaf)

    @cached_property
    def _finest_cells(self) -> Int[Tensor, "frames states"]:
        """Cells of the finest level that each frame's leaves of each state fill."""
        counts = torch.zeros(self.frame_count * 4, dtype=torch.long, device=self.levels[0].states.device)
        for octants in self.levels:
            is_leaf = octants.states != GRAY if octants.level < self.level else octants.states == octants.states
            key = octants.frames.long() * 4 + octants.states
            counts += 8 ** (self.level - octants.level) * key[is_leaf].bincount(minlength=len(counts))
        return counts.reshape(-1, 4)

    def volume(self, state: Literal["hull", "inner", "unknown"] = "hull") -> Float[Tensor, "*batch"]:
        """Cubic metres, float64, of the hull, of its BLACK octants alone ("inner"), or of the UNKNOWN ones."""
        counts = self._finest_cells
        chosen = {"hull": counts[:, GRAY] + counts[:, BLACK], "inner": counts[:, BLACK], "unknown": counts[:, UNKNOWN]}
        return chosen[state].double().reshape(self.batch) * self.leaf_side**3

    @property
    def is_empty(self) -> Bool[Tensor, "*batch"]:
        """Frames whose silhouettes do not meet: they have no hull."""
        return self.volume() == 0

    def occupancy(
        self, *, frame: int = 0, unknown: bool = False, inner: bool = False
    ) -> tuple[Bool[Tensor, "nx ny nz"], tuple[int, int, int]]:
        """The finest cells that a frame's hull fills, in the smallest box of them, and that box's first cell.

        inner: only the BLACK octants. A frame without hull gives an array without cells.
        """
        filled = self._filled(frame, unknown, inner)
        if not filled:
            device = self.levels[0].states.device
            return torch.zeros(0, 0, 0, dtype=torch.bool, device=device), (0, 0, 0)
        first = torch.stack([cells.amin(0) for cells, _ in filled]).amin(0)
        beyond = torch.stack([cells.amax(0) + scale for cells, scale in filled]).amax(0)
        return self._painted(filled, first, tuple((beyond - first).tolist())), tuple(first.tolist())

    def occupancy_in(
        self, first: tuple[int, int, int], size: tuple[int, int, int], *, frame: int = 0, inner: bool = False
    ) -> Bool[Tensor, "nx ny nz"]:
        """`occupancy` within a given box of finest cells, which has to contain the hull."""
        start = torch.tensor(first, device=self.levels[0].states.device)
        return self._painted(self._filled(frame, False, inner), start, size)

    def _filled(self, frame: int, unknown: bool, inner: bool) -> list[tuple[Int[Tensor, "_leaves 3"], int]]:
        """First finest cell of each leaf, and how many it has along a side, of the levels that have any."""
        found = []
        for octants in self.levels:
            at = self._leaves_of(octants, frame, unknown)
            if inner:
                at = at[octants.states[at] == BLACK]
            scale = 2 ** (self.level - octants.level)
            if len(at):
                found.append((octants.cells.index_select(0, at).long() * scale, scale))
        return found

    def _painted(
        self, filled: list[tuple[Int[Tensor, "_leaves 3"], int]], first: Int[Tensor, "3"], size: tuple[int, ...]
    ) -> Bool[Tensor, "nx ny nz"]:
        device = self.levels[0].states.device
        canvas = torch.zeros(size, dtype=torch.bool, device=device)
        flat = canvas.view(-1)
        for cells, scale in filled:
            step = torch.arange(scale, device=device)
            within = (step[:, None, None] * size[1] + step[:, None]) * size[2] + step
            x, y, z = (cells - first).unbind(-1)
            index = ((x * size[1] + y) * size[2] + z)[:, None] + within.flatten()
            flat[index.flatten()] = True
        return canvas


def places_of(condition: Bool[Tensor, "n"]) -> Int[Tensor, "true"]:
    """Where a condition holds; numpy is ten times as fast on a CPU."""
    if condition.device.type == "cpu":
        return torch.from_numpy(np.flatnonzero(condition.numpy()))
    return condition.nonzero()[:, 0]
