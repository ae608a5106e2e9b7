"""Silhouettes as tables of sums, so that one rectangle of a picture is asked about in a few look-ups."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.geometry.cameras import distort

_ROUND_TRIP = 0.01  # px by which a lens model may fail to be undone where it is believed


@dataclass(frozen=True, kw_only=True)
class SumTables:
    """How many pixels of a mask lie above and to the left, of several views (Crow 1984; FACTS section 6).

    A picture gets a frame one pixel wide, and a table one more row and column: entry (i, j) counts the marked pixels in
    the rows before i and the columns before j of the framed picture, whose pixel (0, 0) is that at (-1, -1).
    """

    entries: Int[Tensor, "frames entries"]
    """The tables of all views one after the other, int32."""
    strides: Int[Tensor, "views 1"]
    """Entries of a row."""
    starts: Int[Tensor, "views 1"]
    """Where a view's table starts."""

    def places(
        self,
        left: Int[Tensor, "views n"],
        right: Int[Tensor, "views n"],
        top: Int[Tensor, "views n"],
        bottom: Int[Tensor, "views n"],
    ) -> tuple[Int[Tensor, "views n"], ...]:
        """Entries from which the pixels in rectangles are counted: first row and column within and first beyond."""
        top, bottom = (top * self.strides).add_(self.starts), (bottom * self.strides).add_(self.starts)
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


def sum_tables(masks: Sequence[Bool[Tensor, "frames _height _width"]], *, frame: bool) -> SumTables:
    """The tables of some views; frame: whether the frame around the pictures is marked."""
    device = masks[0].device
    strides = [mask.shape[2] + 3 for mask in masks]
    sizes = [(mask.shape[1] + 3) * stride for mask, stride in zip(masks, strides, strict=True)]
    starts = [sum(sizes[:view]) for view in range(len(sizes))]
    entries = torch.empty(len(masks[0]), sum(sizes), dtype=torch.int32, device=device)
    for mask, start, size, stride in zip(masks, starts, sizes, strides, strict=True):
        _count(mask, entries[:, start : start + size].unflatten(1, (-1, stride)), frame)
    column = [torch.tensor(values, dtype=torch.int32, device=device)[:, None] for values in (strides, starts)]
    return SumTables(entries=entries, strides=column[0], starts=column[1])


def _count(masks: Bool[Tensor, "frames height width"], tables: Int[Tensor, "frames rows columns"], frame: bool) -> None:
    n, height, width = masks.shape
    framed = torch.full((n, height + 2, width + 2), int(frame), dtype=torch.uint8, device=masks.device)
    framed[:, 1:-1, 1:-1] = masks.view(torch.uint8)
    if masks.device.type == "cpu":
        for source, target in zip(framed.numpy(), tables.numpy(), strict=True):
            cv2.integral(source, sum=target, sdepth=cv2.CV_32S)
    else:
        tables.zero_()
        tables[:, 1:, 1:] = framed.cumsum(1, dtype=torch.int32).cumsum(2, dtype=torch.int32)


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
