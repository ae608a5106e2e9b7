"""Silhouettes as tables of sums, so that one rectangle of a picture is asked about in a few look-ups."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import torch
from jaxtyping import Bool, Int, UInt8
from torch import Tensor

from torchhand.geometry import Camera, distort

_ROUND_TRIP = 0.01  # px by which a lens model may fail to be undone where it is believed


@dataclass(frozen=True, kw_only=True)
class SumTables:
    """How many pixels of a mask lie above and to the left, of several views (Crow 1984).

    A picture gets a frame one pixel wide, whose pixel (0, 0) is that at (-1, -1). The table of a view covers a window
    with all marked pixels, and has one more row and column: entry (i, j) counts those in the window's first i rows and
    first j columns.
    """

    entries: Int[Tensor, "frames entries"]
    """The tables of all views one after the other, int32."""
    corners: Int[Tensor, "2 views 1"]
    """First column and row of each window in the framed picture."""
    sizes: Int[Tensor, "2 views 1"]
    """Columns and rows of each window."""
    starts: Int[Tensor, "views 1"]
    """Index at which a view's table starts."""

    def places(
        self, begin: Int[Tensor, "2 views n"], beyond: Int[Tensor, "2 views n"]
    ) -> tuple[Int[Tensor, "views n"], ...]:
        """Entries from which the pixels in rectangles of framed pictures are counted: first column and row within and
        first beyond."""
        nothing, stride = torch.zeros_like(self.sizes), self.sizes[0] + 1
        left, top = torch.clamp(begin - self.corners, nothing, self.sizes)
        right, bottom = torch.clamp(beyond - self.corners, nothing, self.sizes)
        top, bottom = top.mul_(stride).add_(self.starts), bottom.mul_(stride).add_(self.starts)
        return bottom + right, top + right, bottom + left, top + left

    def counts(
        self, places: tuple[Int[Tensor, "views n"], ...], frames: Int[Tensor, "n"] | None
    ) -> Int[Tensor, "views n"]:
        """Marked pixels in the rectangles; frames: that of every column of `places`, None where there is one frame."""
        if frames is not None:
            start = frames.long() * self.entries.shape[1]
            places = tuple(place + start for place in places)
        flat = self.entries.reshape(-1)
        count, minus, also_minus, plus = (flat.index_select(0, place.reshape(-1)) for place in places)
        return count.sub_(minus).sub_(also_minus).add_(plus).reshape(places[0].shape)


def sum_tables(masks: Sequence[Bool[Tensor, "frames _height _width"]]) -> SumTables:
    """The tables of some views."""
    device, n = masks[0].device, len(masks[0])
    cut = [_cut_out(mask) for mask in masks]
    sizes = [(grid.shape[2], grid.shape[1]) for grid, _ in cut]
    entries = [(width + 1) * (height + 1) for width, height in sizes]
    starts = [sum(entries[:view]) for view in range(len(entries))]
    tables = torch.empty(n, sum(entries), dtype=torch.int32, device=device)
    for (grid, _), start, count, (width, _) in zip(cut, starts, entries, sizes, strict=True):
        _count(grid, tables[:, start : start + count].unflatten(1, (-1, width + 1)))

    def columns(values: list[tuple[int, int]]) -> Int[Tensor, "2 views 1"]:
        return torch.tensor(values, dtype=torch.int32, device=device).T[..., None].contiguous()

    return SumTables(
        entries=tables,
        corners=columns([corner for _, corner in cut]),
        sizes=columns(sizes),
        starts=torch.tensor(starts, dtype=torch.int32, device=device)[:, None],
    )


def _cut_out(
    mask: Bool[Tensor, "frames height width"],
) -> tuple[UInt8[Tensor, "frames rows columns"], tuple[int, int]]:
    """The window that holds all marked pixels of a view, and its first column and row in the framed picture."""
    pixels = mask.view(torch.uint8)
    if mask.device.type != "cpu" or not mask.numel():
        return pixels, (1, 1)
    marked = pixels[0] if len(pixels) == 1 else pixels.amax(0)
    left, top, width, height = cv2.boundingRect(marked.contiguous().numpy())
    return pixels[:, top : top + height, left : left + width], (left + 1, top + 1)


def _count(grids: UInt8[Tensor, "frames height width"], tables: Int[Tensor, "frames rows columns"]) -> None:
    if grids.device.type == "cpu" and grids.numel():
        for source, target in zip(grids.contiguous().numpy(), tables.numpy(), strict=True):
            cv2.integral(source, sum=target, sdepth=cv2.CV_32S)
    else:
        tables.zero_()
        tables[:, 1:, 1:] = grids.cumsum(1, dtype=torch.int32).cumsum(2, dtype=torch.int32)


class LensCorrection:
    """Masks of a camera with a distorting lens, resampled to those of the same camera without one.

    Every pixel of the corrected picture shows the nearest one of the picture, which is less than a pixel away.
    """

    def __init__(self, camera: Camera, device: torch.device) -> None:
        camera = camera.to(dtype=torch.float64, device="cpu")
        ideal = replace(camera, distortion=camera.distortion.new_zeros(0))
        rows, columns = (torch.arange(n, dtype=torch.float64) for n in (camera.height, camera.width))
        pixels = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1)
        seen = ideal.pixels_from_plane(distort(ideal.plane_from_pixels(pixels), camera.distortion))
        back = ideal.pixels_from_plane(camera.plane_from_pixels(seen))
        place = seen.nan_to_num(-1e6).clamp(-1e6, 1e6).round().long()
        inside = (place >= 0).all(-1) & (place[..., 0] < camera.width) & (place[..., 1] < camera.height)
        is_shown = inside & ((back - pixels).abs().amax(-1) < _ROUND_TRIP)
        self._source = (place[..., 1] * camera.width + place[..., 0]).where(is_shown, 0).reshape(-1).to(device)
        self.is_shown = is_shown.to(device)
        """Pixels of the corrected picture that show something of the picture."""

    def __call__(self, masks: Bool[Tensor, "frames height width"]) -> Bool[Tensor, "frames height width"]:
        """The corrected masks; False where nothing is shown."""
        return masks.flatten(1).index_select(1, self._source).reshape(masks.shape) & self.is_shown
