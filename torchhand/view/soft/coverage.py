"""How much of every pixel closed polygons cover.

The area within a pixel is a sum over edges, each of which covers what lies to its right: a trapezoid of the pixel that
it crosses, and all of the pixels beyond. Of all edges, that sum counts areas twice where polygons overlap; of those
that bound the union it is exact. Which ones do is asked only in pixels that an estimate does not call full with all of
their neighbours: the sum of all edges or, where polygons overlap, their union on `LINES` lines per row of pixels.
"""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.view.soft.pieces import Pieces, cells

LINES = 4
"""Lines per row of pixels on which overlapping polygons are united."""
_FAR = 1e6  # px, beyond any picture
_SAME = 1e-9  # px: edges that are no farther apart are one upon the other, in the order of their numbers
_OVERLAPPING = 1e-4  # of a pixel's area: less is rounding


def coverage(
    outer: Pieces, beside: Pieces, first: Tensor, last: Tensor, estimated: Float[Tensor, "pictures height width"]
) -> Float[Tensor, "pictures height width"]:
    """Share of each pixel's area within the union of the polygons; continuous in their corners.

    outer: pieces within the pictures that bound the union. beside: those to the left of the pictures. Every row is
    summed up from the last pixel on without a piece, which is full or empty as `estimated` says, so that a piece that
    is missed is missed there alone.
    """
    count, height, width = estimated.shape
    filled = _filled_by(outer, first, last, (count, height, width))
    is_cut = torch.zeros_like(estimated, dtype=torch.bool).reshape(-1)
    is_cut[outer.row * width + outer.column] = True
    is_cut = is_cut.reshape(estimated.shape)
    is_known = ~is_cut & ((estimated < _OVERLAPPING) | (estimated > 1 - _OVERLAPPING))
    column = torch.arange(1, width + 1, device=filled.device)
    begin = torch.where(is_known, column, 0).cummax(-1).values
    at_left = _covered_border(beside, first, last, count * height, height).reshape(count, height, 1)
    lacking = torch.cat((at_left, estimated - filled), -1).gather(-1, begin)
    return torch.where(is_cut, filled + lacking, estimated).clamp(0, 1)


def _covered_border(beside: Pieces, first: Tensor, last: Tensor, rows: int, height: int) -> Float[Tensor, "rows"]:
    """Share of the border at the left of each row that lies within the union of the polygons."""
    low, high = (ends[:, 1].index_select(0, beside.edge) for ends in (first, last))
    y = torch.cat([torch.lerp(low, high, at) for at in (beside.start, beside.end)]).double()
    row = beside.row.repeat(2)
    key, order = (2 * row + (y - row % height).clamp(0, 1)).sort()
    # A polygon is to the right of an edge that goes down: it begins where that begins, and where one that goes up ends.
    changes = torch.cat((torch.ones_like(beside.row), -torch.ones_like(beside.row)))
    is_within = changes.index_select(0, order).cumsum(0) > 0
    length = torch.where(is_within, key.roll(-1) - key, 0.0).to(first)
    return first.new_zeros(rows).index_add_(0, row.index_select(0, order), length)


def estimate(
    pieces: Pieces,
    first: Float[Tensor, "edges 2"],
    last: Float[Tensor, "edges 2"],
    picture: Int[Tensor, "edges"],
    size: tuple[int, int, int],
) -> Float[Tensor, "pictures height width"]:
    """Share of each pixel's area within the union, good to some hundredths where polygons overlap. size: pictures,
    height, width."""
    union, overlap = united(first, last, picture, size)
    return torch.where(overlap > _OVERLAPPING, union, _filled_by(pieces, first, last, size)).clamp(0, 1)


def _filled_by(
    pieces: Pieces, first: Tensor, last: Tensor, size: tuple[int, int, int]
) -> Float[Tensor, "pictures height width"]:
    """Area of each pixel within the polygons; what lies in several of them is counted as often."""
    x, y = first.index_select(0, pieces.edge).unbind(1)
    dx, dy = (last.index_select(0, pieces.edge) - torch.stack((x, y), 1)).unbind(1)
    middle = x + dx * 0.5 * (pieces.start + pieces.end)
    fraction = (middle - pieces.column).clamp(0, 1)
    place = pieces.row * (size[2] + 3) + pieces.column + 1
    return _filled_right(place, dy * (pieces.end - pieces.start), fraction, size)


def _filled_right(place: Tensor, amount: Tensor, fraction: Tensor, size: tuple[int, int, int]) -> Tensor:
    """Pictures whose rows are covered by `amount` to the right of places within them."""
    count, height, width = size
    rows = amount.new_zeros(count * height * (width + 3))
    beyond = amount * fraction
    rows.index_add_(0, place, amount - beyond).index_add_(0, place + 1, beyond)
    return rows.reshape(count, height, width + 3).cumsum(-1)[..., 1 : width + 1]


def united(first: Tensor, last: Tensor, picture: Tensor, size: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
    """Shares of each pixel, as the lines tell, that lie within the union and within two polygons or more."""
    _, height, width = size
    lines = height * LINES
    y0, y1 = LINES * first[:, 1], LINES * last[:, 1]
    low, high = torch.minimum(y0, y1), torch.maximum(y0, y1)
    begin = (low - 0.5).ceil().clamp_min(0)  # a line is crossed where low <= its y < high
    edge, line = cells(((high - 0.5).ceil().clamp_max(lines) - begin).clamp_min(0), begin)
    ay, by, ax, bx = (value.index_select(0, edge) for value in (y0, y1, first[:, 0], last[:, 0]))
    x = torch.lerp(ax, bx, (line + 0.5 - ay) / (by - ay)).clamp(-1, width + 1)
    line = line + picture.index_select(0, edge) * lines
    key = line * float(width + 4) + (x + 1).double()
    order = key.argsort()
    sign = torch.where(by > ay, 1, -1).index_select(0, order)
    inside = sign.cumsum(0)  # every line begins and ends outside
    outside = inside - sign
    x, line = x.index_select(0, order), line.index_select(0, order)
    column = x.floor()
    place = line.div(LINES, rounding_mode="floor") * (width + 3) + column.long() + 1
    amounts = [((inside > level).to(x) - (outside > level).to(x)) / LINES for level in (0, 1)]
    union, overlap = (_filled_right(place, amount, x - column, size) for amount in amounts)
    return union, overlap


def lies_within(asked: Pieces, rows: Pieces, first: Tensor, last: Tensor) -> Bool[Tensor, "asked"]:
    """Whether the middle of a piece lies within another polygon, or doubly within its own: it does not bound the union.

    On the line through the middle, edges to its left say how many polygons it is in.
    """
    x0, step = first[:, 0].index_select(0, rows.edge), (last - first)[:, 0].index_select(0, rows.edge)
    leftmost = torch.minimum(x0 + rows.start * step, x0 + rows.end * step)
    stride = _FAR + 1.0
    key, order = (rows.row * stride + leftmost.clamp(0, _FAR).double()).sort()
    edge_of = rows.edge.index_select(0, order)
    middle = torch.lerp(
        first.index_select(0, asked.edge),
        last.index_select(0, asked.edge),
        0.5 * (asked.start + asked.end)[:, None],
    )
    line = asked.row * stride
    begin = torch.searchsorted(key, line)
    end = torch.searchsorted(key, line + middle[:, 0] + _SAME, right=True)
    owner, candidate = cells((end - begin).clamp_min(0), begin)
    candidate = edge_of.index_select(0, candidate)
    # First by height alone: of the edges in a row of pixels, some end above or below the line.
    y = middle[:, 1].index_select(0, owner)
    ay, by = (ends[:, 1].contiguous().index_select(0, candidate) for ends in (first, last))
    is_own = candidate == asked.edge.index_select(0, owner)
    level = ((torch.minimum(ay, by) <= y) & (y < torch.maximum(ay, by)) & ~is_own).nonzero()[:, 0]
    owner, candidate, y = (part.index_select(0, level) for part in (owner, candidate, y))
    ax, ay, bx, by = torch.cat((first, last), 1).index_select(0, candidate).unbind(1)
    gap = middle[:, 0].index_select(0, owner) - torch.lerp(ax, bx, (y - ay) / (by - ay))
    is_earlier = candidate < asked.edge.index_select(0, owner)
    is_left = torch.where(gap.abs() < _SAME, is_earlier, gap > 0)
    sign = torch.where(by > ay, 1, -1) * is_left
    dx, dy = (last - first).unbind(1)
    # Outside of an edge that goes up is to its right; a level one counts as seen from just below.
    is_right_end = ((dy < 0) | ((dy == 0) & (dx < 0))).index_select(0, asked.edge)
    winding = -is_right_end.long()
    return winding.index_add_(0, owner, sign) > 0
