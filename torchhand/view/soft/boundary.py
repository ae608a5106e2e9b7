"""What a picture of polygons changes by where their boundaries move.

A boundary that moves by v changes the coverage of a pixel by the integral of v · n along the piece of boundary within
the pixel, n being its outward normal, and the integral of another quantity by that times the jump of the quantity
across the boundary (Reynolds' transport theorem). On a straight edge v is linear between its ends, and the integral has
a closed form. No edge is blurred for it, and no sample has to lie near one.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from torchhand.view.soft.coverage import coverage, estimate, lies_within
from torchhand.view.soft.edges import ContourEdges
from torchhand.view.soft.pieces import Pieces, cut_at_columns, cut_at_crossings, cut_at_rows, joined, shown_pieces

Kept = Literal["outer", "all"]
"""Pieces of edges that are wanted: with what no other part of the surface is beyond, or those within it too."""
_FULL = 1 - 1e-6  # coverage above which only rounding is missing


@dataclass(frozen=True, kw_only=True)
class Boundary:
    """What polygons cover, and their edges in pieces, each within one pixel."""

    coverage: Float[Tensor, "pictures height width"]
    pieces: Pieces
    """Pieces within the pictures, as many as were asked for."""
    pixel: Int[Tensor, "pieces"]
    """Pixel of each piece, in the flat list of all pictures' pixels."""
    ends: Int[Tensor, "pieces 2"]
    """Ends of each piece's edge, in the flat list of all pictures' vertices."""
    is_outer: Bool[Tensor, "pieces"]
    """Beyond it is nothing; beyond the others is another part of the surface."""


def boundary(
    points_px: Float[Tensor, "points 2"], contour: ContourEdges, size: tuple[int, int, int], *, kept: Kept
) -> Boundary:
    """The boundary of polygons in pictures. size: pictures, height, width. kept: which pieces are.

    Found in double precision: whether an edge is before another one or behind decides about whole pixels.
    """
    first, last = (points_px.index_select(0, end).double() + 0.5 for end in contour.ends.unbind(1))
    rows = cut_at_rows(first, last, contour.picture, size)
    pieces = cut_at_columns(rows, first, last, size)
    estimated = estimate(pieces, first, last, contour.picture, size)
    shown = shown_pieces(pieces, size[2])
    is_full = _surely_full(estimated).reshape(-1).index_select(0, shown.row * size[2] + shown.column)
    ajar = cut_at_crossings(shown.select((~is_full).nonzero()[:, 0]), first, last, size[2])
    is_outer = ~lies_within(ajar, rows, first, last)
    outer, beside = ajar.select(is_outer.nonzero()[:, 0]), pieces.select((pieces.column < 0).nonzero()[:, 0])
    covered = coverage(outer, beside, first, last, estimated)
    if kept == "all":
        within = shown.select(is_full.nonzero()[:, 0])
        shown, is_outer = joined(ajar, within), torch.cat((is_outer, torch.zeros_like(within.edge, dtype=torch.bool)))
    else:
        shown, is_outer = outer, torch.ones_like(outer.edge, dtype=torch.bool)
    return Boundary(
        coverage=covered.to(points_px),
        pieces=replace(shown, start=shown.start.to(points_px), end=shown.end.to(points_px)),
        pixel=shown.row * size[2] + shown.column,
        ends=contour.ends.index_select(0, shown.edge),
        is_outer=is_outer,
    )


def _surely_full(covered: Float[Tensor, "pictures height width"]) -> Bool[Tensor, "pictures height width"]:
    """Pixels that are covered with all of their neighbours.

    A gap that is so narrow that it escapes the lines of a pixel opens into one beside it.
    """
    is_full = torch.nn.functional.pad(covered > _FULL, (1, 1, 1, 1), value=True)
    is_full = is_full[:, :-2] & is_full[:, 1:-1] & is_full[:, 2:]
    return is_full[..., :-2] & is_full[..., 1:-1] & is_full[..., 2:]


def with_moving_boundary(
    picture: Float[Tensor, "pictures height width"],
    points_px: Float[Tensor, "points 2"],
    found: Boundary,
    jump: Float[Tensor, "pieces"],
) -> Float[Tensor, "pictures height width"]:
    """The picture, whose gradient flows to the points of its boundary too.

    jump: what a piece's pixel changes by for one px² that the piece sweeps outward.
    """
    moves = jump.nonzero()[:, 0]
    pixel, ends, start, end = (
        part.index_select(0, moves) for part in (found.pixel, found.ends, found.pieces.start, found.pieces.end)
    )
    out = MovingBoundary.apply(picture, points_px, ends, torch.stack((start, end), 1), pixel, jump[moves])
    assert isinstance(out, Tensor)
    return out


class MovingBoundary(torch.autograd.Function):
    """A picture that is differentiable in the points of its boundary as well as in its values; once."""

    @staticmethod
    def forward(
        ctx: Any,
        picture: Float[Tensor, "pictures height width"],
        points_px: Float[Tensor, "points 2"],
        ends: Int[Tensor, "pieces 2"],
        span: Float[Tensor, "pieces 2"],
        pixel: Int[Tensor, "pieces"],
        jump: Float[Tensor, "pieces"],
    ) -> Float[Tensor, "pictures height width"]:
        """The picture as it is. span: start and end of each piece along its edge, 0 to 1."""
        ctx.save_for_backward(points_px, ends, span, pixel, jump)
        return picture.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        points, ends, span, pixel, jump = ctx.saved_tensors
        force = grad.reshape(-1).index_select(0, pixel) * jump
        start, end = span.unbind(1)
        rear = 0.5 * (end * end - start * start)
        front = (end - start) - rear
        dx, dy = (points.index_select(0, ends[:, 1]) - points.index_select(0, ends[:, 0])).unbind(1)
        outward = force[:, None] * torch.stack((-dy, dx), 1)
        moved = torch.zeros_like(points)
        for part, corner in ((front, 0), (rear, 1)):
            moved.index_add_(0, ends[:, corner], part[:, None] * outward)
        return grad, moved, None, None, None, None
