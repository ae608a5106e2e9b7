"""Which pixels a triangle covers: runs along the rows where edges are straight in pixels, else tests one by one.

Both ways are closed and watertight: whatever two neighbours compute of their common edge is equal to the last bit, and
a pixel whose centre lies on the edge belongs to both.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.view.raster.boxes import square_outline

_NEXT = (1, 2, 0)
_LENS_MARGIN_PX = 1.0
_BEND_MARGIN = 2.0  # how much more than at the middle of a side of its box a lens may bend it


@dataclass(frozen=True, kw_only=True)
class Spans:
    """Runs of covered pixels: in `row`, columns `first` to `last` with both ends."""

    triangle: Int[Tensor, "spans"]
    row: Int[Tensor, "spans"]
    first: Int[Tensor, "spans"]
    last: Int[Tensor, "spans"]


def row_spans(corners_px: Float[Tensor, "triangles 3 2"], width: int, height: int) -> Spans:
    """The run of every triangle in every row of the picture whose pixels it covers; empty runs are left out.

    The level of its middle corner cuts a triangle into an upper and a lower half; in a row, a half reaches from the
    long edge to one of the short ones. A triangle without height has no run: its edges belong to its neighbours too.
    """
    x, y = _downwards(corners_px).unbind(-1)
    short_y, short_x = torch.cat((y[:, :2], y[:, 1:])), torch.cat((x[:, :2], x[:, 1:]))
    (low, high), (left, right) = short_y.unbind(-1), (side.repeat(2) for side in x.aminmax(dim=-1))
    top, bottom = low.ceil().clamp(0, height).long(), high.floor().clamp(-1, height - 1).long()
    is_seen = (right >= 0) & (left <= width - 1) & (low < high)
    rows = torch.where(is_seen, bottom - top + 1, 0).clamp_min(0)
    half = torch.repeat_interleave(rows)
    row = numbered(rows, half) + top.index_select(0, half)
    long_y, long_x = y[:, ::2].repeat(2, 1), x[:, ::2].repeat(2, 1)
    edges = torch.cat((long_y, long_x, short_y, short_x), -1).index_select(0, half).unbind(-1)
    level = row.to(x)
    long, short = _crossing(level, *edges[:4]), _crossing(level, *edges[4:])
    first = torch.minimum(long, short).ceil().clamp_min(0)
    last = torch.maximum(long, short).floor().clamp_max(width - 1)
    kept = (first <= last).nonzero()[:, 0]
    half, row, first, last = (part.index_select(0, kept) for part in (half, row, first, last))
    return Spans(triangle=half % len(corners_px), row=row, first=first.long(), last=last.long())


def _downwards(corners: Float[Tensor, "triangles 3 2"]) -> Float[Tensor, "triangles 3 2"]:
    """The corners of each triangle by y, then by x: an edge has the same direction in both of its triangles."""
    a, b, c = corners.unbind(1)
    a, b = _in_order(a, b)
    b, c = _in_order(b, c)
    a, b = _in_order(a, b)
    return torch.stack((a, b, c), 1)


def _in_order(one: Float[Tensor, "n 2"], other: Float[Tensor, "n 2"]) -> tuple[Tensor, Tensor]:
    swaps = ((other[:, 1] < one[:, 1]) | ((other[:, 1] == one[:, 1]) & (other[:, 0] < one[:, 0])))[:, None]
    return torch.where(swaps, other, one), torch.where(swaps, one, other)


def _crossing(level: Tensor, upper_y: Tensor, lower_y: Tensor, upper_x: Tensor, lower_x: Tensor) -> Float[Tensor, "n"]:
    """Where an edge crosses a row; exact at both of its ends."""
    return torch.lerp(upper_x, lower_x, (level - upper_y) / (lower_y - upper_y))


def numbered(counts: Int[Tensor, "n"], owner: Int[Tensor, "total"]) -> Int[Tensor, "total"]:
    """0, 1, 2 ... for each run of `owner = torch.repeat_interleave(counts)`."""
    before = counts.cumsum(0) - counts
    return torch.arange(len(owner), device=owner.device) - before.index_select(0, owner)


def tested_pixels(
    corners: Float[Tensor, "triangles 3 2"], camera: Camera
) -> tuple[Int[Tensor, "pairs"], Int[Tensor, "pairs"], Float[Tensor, "pairs 2"]]:
    """Triangle, pixel (row · width + column) and the pixel's point of the plane wherever a triangle covers a pixel.

    For lenses that distort: corners on the normalised image plane. Every pixel of a box around the triangle in the
    picture is tested. Slower than `row_spans` many times over.
    """
    first, last = _boxes(corners, camera)
    columns, rows = (last - first + 1).clamp_min(0).unbind(-1)
    count = columns * rows
    triangle = torch.repeat_interleave(count)
    inside = numbered(count, triangle)
    column = first[:, 0][triangle] + inside % columns[triangle]
    row = first[:, 1][triangle] + inside // columns[triangle]
    pixel = row * camera.width + column
    plane = _plane_at(pixel, corners, camera)
    x, y = (corners[triangle] - plane[:, None]).unbind(-1)
    # Antisymmetric in the edge's ends to the last bit, and rounded products keep their order: no cracks.
    cross = x * y[:, _NEXT] - y * x[:, _NEXT]
    is_covered = (cross >= 0).all(-1) | (cross <= 0).all(-1)
    kept = is_covered.nonzero()[:, 0]
    return triangle[kept], pixel[kept], plane[kept]


def _plane_at(pixel: Int[Tensor, "n"], like: Tensor, camera: Camera) -> Float[Tensor, "n 2"]:
    """Points of the plane that appear at pixels, each undone of the lens once however often it occurs."""
    is_asked = torch.zeros(camera.height * camera.width, dtype=torch.bool, device=pixel.device)
    is_asked[pixel] = True
    asked = is_asked.nonzero()[:, 0]
    table = like.new_zeros(len(is_asked), 2)
    table[asked] = camera.plane_from_pixels(torch.stack((asked % camera.width, asked // camera.width), -1).to(like))
    return table.index_select(0, pixel)


def _boxes(
    corners: Float[Tensor, "triangles 3 2"], camera: Camera
) -> tuple[Int[Tensor, "triangles 2"], Int[Tensor, "triangles 2"]]:
    """First and last column and row of a box in the picture around each triangle; last < first where there is none.

    The triangle's box on the plane is cut to what the picture shows of the plane, for beyond that the lens model means
    nothing, and its outline carried through the lens.
    """
    size = torch.tensor((camera.width - 1, camera.height - 1), dtype=corners.dtype, device=corners.device)
    steps = max(camera.width, camera.height)
    shown = camera.plane_from_pixels(square_outline(steps, corners) * (size + 1) - 0.5)
    low = torch.maximum(corners.amin(1), shown.amin(0))
    high = torch.minimum(corners.amax(1), shown.amax(0))
    outline = square_outline(2, corners)
    points = camera.pixels_from_plane(low[:, None] + outline * (high - low)[:, None])
    ends, middles = points[:, ::2], points[:, 1::2]
    bend = (middles - 0.5 * (ends + ends.roll(-1, 1))).abs().amax(1)
    margin = _LENS_MARGIN_PX + _BEND_MARGIN * bend
    first = (points.amin(1) - margin).ceil().clamp_min(0)
    last = torch.minimum((points.amax(1) + margin).floor(), size)
    is_shown = (low <= high).all(-1, keepdim=True) & (first <= last).all(-1, keepdim=True)
    return torch.where(is_shown, first, 0.0).long(), torch.where(is_shown, last, -1.0).long()
