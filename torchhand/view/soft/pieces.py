"""Edges of polygons cut at the borders of pixels and where they cross each other.

Coordinates are those in which pixel (0, 0) is the square [0, 1]².
"""

from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """Edges cut at the borders between rows of pixels, or between pixels."""

    edge: Int[Tensor, "pieces"]
    row: Int[Tensor, "pieces"]
    """Row of the list of all pictures' rows, one picture after the other."""
    column: Int[Tensor, "pieces"]
    """-1 for what is left of the picture, its width for what is right of it; 0 where only rows are cut."""
    start: Float[Tensor, "pieces"]
    """Place of the piece's beginning along its edge, 0 to 1."""
    end: Float[Tensor, "pieces"]

    def select(self, index: Int[Tensor, "n"]) -> "Pieces":
        """Some of the pieces."""
        return Pieces(**{f.name: getattr(self, f.name).index_select(0, index) for f in fields(self)})


def joined(one: Pieces, other: Pieces) -> Pieces:
    """All pieces of both."""
    return Pieces(**{f.name: torch.cat((getattr(one, f.name), getattr(other, f.name))) for f in fields(Pieces)})


def cut_at_rows(first: Tensor, last: Tensor, picture: Int[Tensor, "edges"], size: tuple[int, int, int]) -> Pieces:
    """Pieces of the edges in every row of the pictures; what lies above and below is left out."""
    height = size[1]
    y, step = first[:, 1], last[:, 1] - first[:, 1]
    low, high = torch.minimum(y, last[:, 1]), torch.maximum(y, last[:, 1])
    begin = low.floor()
    counts = (torch.maximum(high.ceil() - 1, begin).clamp_max(height - 1) - begin.clamp_min(0) + 1).clamp_min(0)
    edge, cell = cells(counts, begin.clamp_min(0))
    origin, step = y.index_select(0, edge), step.index_select(0, edge)
    begins, ends = torch.zeros_like(origin), torch.ones_like(origin)
    start, end = _within(cell.to(y), (cell + 1).to(y), origin, step, begins, ends)
    row = picture.index_select(0, edge) * height + cell
    return Pieces(edge=edge, row=row, column=torch.zeros_like(edge), start=start, end=end)


def cut_at_columns(rows: Pieces, first: Tensor, last: Tensor, size: tuple[int, int, int]) -> Pieces:
    """The pieces cut once more, at the borders between the pixels of a row."""
    width = size[2]
    x = first[:, 0].index_select(0, rows.edge)
    step = last[:, 0].index_select(0, rows.edge) - x
    ends = (x + rows.start * step, x + rows.end * step)
    low, high = torch.minimum(*ends), torch.maximum(*ends)
    begin = low.floor()
    top = torch.maximum(high.ceil() - 1, begin).clamp(-1, width)
    begin = begin.clamp(-1, width)
    piece, cell = cells(top - begin + 1, begin)
    lower = torch.where(cell == -1, -torch.inf, cell.to(x))
    upper = torch.where(cell == width, torch.inf, (cell + 1).to(x))
    x, step, start, end = (part.index_select(0, piece) for part in (x, step, rows.start, rows.end))
    start, end = _within(lower, upper, x, step, start, end)
    edge, row = (part.index_select(0, piece) for part in (rows.edge, rows.row))
    return Pieces(edge=edge, row=row, column=cell, start=start, end=end)


def cells(counts: Tensor, begin: Tensor) -> tuple[Int[Tensor, "cells"], Int[Tensor, "cells"]]:
    """Owner and number of cells of which each owner has `counts` from `begin` on."""
    counts = counts.long()
    owner = torch.repeat_interleave(counts)
    shift = begin.long() - (counts.cumsum(0) - counts)
    return owner, torch.arange(len(owner), device=owner.device) + shift.index_select(0, owner)


def _within(
    lower: Tensor, upper: Tensor, origin: Tensor, step: Tensor, start: Tensor, end: Tensor
) -> tuple[Tensor, Tensor]:
    """Start and end of the part of `start` to `end` for which origin + t step lies from `lower` to `upper`."""
    is_across = step != 0
    safe = torch.where(is_across, step, 1.0)
    one, other = (lower - origin) / safe, (upper - origin) / safe
    enters, leaves = torch.minimum(one, other), torch.maximum(one, other)
    enters = torch.minimum(torch.maximum(enters, start), end)
    leaves = torch.minimum(torch.maximum(leaves, start), end)
    return torch.where(is_across, enters, start), torch.where(is_across, leaves, end)


def shown_pieces(pieces: Pieces, width: int) -> Pieces:
    """Those within the picture that are more than a point."""
    is_shown = (pieces.column >= 0) & (pieces.column < width) & (pieces.end > pieces.start)
    return pieces.select(is_shown.nonzero()[:, 0])


def cut_at_crossings(pieces: Pieces, first: Tensor, last: Tensor, width: int) -> Pieces:
    """The pieces cut where they cross another one, which can only be one in the same pixel."""
    pixel, order = (pieces.row * width + pieces.column).sort(stable=True)
    last_of_pixel = torch.searchsorted(pixel, pixel, right=True)
    place = torch.arange(len(pixel), device=pixel.device)
    one, other = cells(last_of_pixel - place - 1, place + 1)
    one, other = order.index_select(0, one), order.index_select(0, other)
    edges = [pieces.edge.index_select(0, which) for which in (one, other)]
    (ax, ay), (cx, cy) = (first.index_select(0, edge).unbind(1) for edge in edges)
    (bx, by), (dx, dy) = (last.index_select(0, edge).unbind(1) for edge in edges)
    ux, uy, vx, vy, wx, wy = bx - ax, by - ay, dx - cx, dy - cy, cx - ax, cy - ay
    turn = ux * vy - uy * vx
    along = [(wx * vy - wy * vx) / turn, (wx * uy - wy * ux) / turn]
    meets = torch.ones_like(one, dtype=torch.bool)
    for which, t in zip((one, other), along, strict=True):
        start, end = pieces.start.index_select(0, which), pieces.end.index_select(0, which)
        meets &= (t > start) & (t < end)
    found = meets.nonzero()[:, 0]
    cut = torch.cat([which.index_select(0, found) for which in (one, other)])
    at = torch.cat([t.index_select(0, found) for t in along])
    owner = torch.cat((torch.arange(len(pieces.edge), device=cut.device), cut))
    start = torch.cat((pieces.start, at))
    order = start.argsort(stable=True)
    order = order.index_select(0, owner.index_select(0, order).argsort(stable=True))
    owner, start = owner.index_select(0, order), start.index_select(0, order)
    is_last = torch.ones_like(owner, dtype=torch.bool)
    is_last[:-1] = owner[1:] != owner[:-1]
    end = torch.where(is_last, pieces.end.index_select(0, owner), start.roll(-1))
    return replace(pieces.select(owner), start=start, end=end)
