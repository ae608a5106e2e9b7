"""Distance maps that are read between their pixels, with the gradient."""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

_NOTHING = 1e-24  # px²: keeps the slope of a length finite at zero


@dataclass(frozen=True, kw_only=True)
class DistanceField:
    """Exact distance maps of one picture, sampled bilinearly.

    A field with two sides is signed: the first holds the distances from the outermost pixels inside a boundary, the
    second those from the innermost outside it. Between the two the distance from the boundary runs linearly through
    zero, which a single map, folded there, cannot give: a boundary is found to a small part of a pixel. Far away it is
    positive outside and negative inside.
    """

    maps: Float[Tensor, "sides channels height width"]
    """Distances from marked pixels, in px of the picture; the map's diagonal where a channel has none."""
    origin_px: tuple[float, float]
    """Place (x, y) of the first map pixel's centre in the picture."""
    pitch_px: float
    """Pixels of the picture per pixel of the map."""

    @property
    def channels(self) -> int:
        return self.maps.shape[1]

    def sample(
        self, points_px: Float[Tensor, "*batch 2"], channel: Int[Tensor, "*batch"] | None = None
    ) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch 2"]]:
        """Distance in px at points (x, y) of the picture, and its gradient; in the dtype of the points.

        channel: of every point; the first where it is None. Beyond the map's edge the distance at the nearest point of
        the edge grows with the distance from there, so that what is outside is drawn back. The value can also be
        differentiated by autograd. Points that are not finite give NaN.
        """
        columns = points_px.reshape(-1, 2).T
        value, gradient = self.sample_columns(columns, None if channel is None else channel.reshape(-1))
        return value.reshape(points_px.shape[:-1]), gradient.T.reshape(points_px.shape)

    def sample_columns(
        self, points_px: Float[Tensor, "*batch 2 points"], channel: Int[Tensor, "*batch points"] | None = None
    ) -> tuple[Float[Tensor, "*batch points"], Float[Tensor, "*batch 2 points"]]:
        """`sample` where x and y of all points stand in a row each, which is faster for many."""
        first, last, last_cell = self._frame.to(points_px).unbind()
        clamped = torch.minimum(torch.maximum(points_px, first), last)
        place = (clamped - first) / self.pitch_px
        cell = torch.minimum(place.detach().nan_to_num().floor(), last_cell)
        x, y = (place - cell).unbind(-2)
        left, right = (
            self._read(cell.long(), channel).to(points_px.dtype).unbind(1)
        )  # each (rows, sides, *batch, points)
        (top, bottom), (across, across_below) = torch.lerp(left, right, x).unbind(), (right - left).unbind()
        value = torch.lerp(top, bottom, y)
        found = torch.stack((value, torch.lerp(across, across_below, y), bottom - top), -2)
        if len(self.maps) == 1:
            found = found[0]
        else:
            is_outside = (value[0] > value[1]).to(value)
            found[..., 0, :] -= 0.5 * self.pitch_px
            # As a share, 0 or 1, it picks faster than `where`.
            found = torch.lerp(-found[1], found[0], is_outside.unsqueeze(-2))
        value, slope = found[..., 0, :], found[..., 1:, :] / self.pitch_px
        outside = points_px - clamped
        away = torch.copysign((outside.square().sum(-2) + _NOTHING).sqrt(), value)
        return value + away, torch.where(outside == 0, slope, outside / away.unsqueeze(-2))

    @cached_property
    def _frame(self) -> Float[Tensor, "3 2 1"]:
        """First and last map pixel's centre in the picture, and the last cell's place in the map; (x, y), float64."""
        height, width = self.maps.shape[-2:]
        last = [
            start + self.pitch_px * (count - 1) for start, count in zip(self.origin_px, (width, height), strict=True)
        ]
        rows = (self.origin_px, last, (width - 2, height - 2))
        with torch.inference_mode(False):  # kept for callers in any mode
            return torch.tensor(rows, dtype=torch.float64, device=self.maps.device)[..., None]

    @cached_property
    def _corners(self) -> Int[Tensor, "corners 1"]:
        """Steps in memory from a cell's first corner to all four, on each side: rows, columns, sides."""
        sides, channels, height, width = self.maps.shape
        with torch.inference_mode(False):
            corners = torch.tensor((0, 1, width, width + 1), device=self.maps.device)
            on_side = channels * height * width * torch.arange(sides, device=self.maps.device)
            return (corners[:, None] + on_side).reshape(-1, 1)

    def _read(self, cell: Int[Tensor, "*batch 2 points"], channel: Tensor | None) -> Tensor:
        """The corners of cells given by column and row: (rows, columns, sides, *batch, points)."""
        height, width = self.maps.shape[-2:]
        column, row = cell.unbind(-2)
        index = torch.add(column, row, alpha=width)
        if channel is not None:
            index = torch.add(index, channel, alpha=height * width)
        places = (self._corners + index.reshape(-1)).reshape(-1)
        return self.maps.view(-1).index_select(0, places).reshape(2, 2, len(self.maps), *index.shape)
