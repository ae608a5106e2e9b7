"""Cameras that are late: what one of them shows in a frame is the hand of another time."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

MAX_LAG = 3  # frames
_AROUND = MAX_LAG + 1


@dataclass(frozen=True, kw_only=True)
class ViewLag:
    """How late the pictures of one camera are, which is one of the shared unknowns of a problem."""

    around_px: Float[Tensor, "rows window 21 2"]
    """Points of the frames around every row's own, which is in the middle; none missing where the row's own is not."""
    lag: Float[Tensor, ""]
    """Frames by which the pictures are late: the hand of a frame is seen so much later. At most MAX_LAG."""
    std: float
    """Standard deviation of the lag about 0 as far as it is known beforehand, frames; above 0."""
    place: int
    """Place among the unknowns after the shape."""

    @classmethod
    def of(cls, points_px: Float[Tensor, "frames 21 2"], *, std: float, place: int) -> "ViewLag":
        """No lag. points_px: of the frames of a recording in their order; NaN for missing points."""
        return cls(around_px=_around(points_px), lag=points_px.new_zeros(()), std=std, place=place)

    def at(self, extra: Float[Tensor, "extra"] | None) -> "ViewLag":
        """As all unknowns after the shape say; None keeps it."""
        return self if extra is None or len(extra) <= self.place else replace(self, lag=extra[self.place])

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "ViewLag":
        """Of some of the frames."""
        return replace(self, around_px=self.around_px[rows])

    def of_hands(self, count: int) -> "ViewLag":
        """Of so many hands: the points of one frame are those of all."""
        return replace(self, around_px=self.around_px.expand(count, -1, -1, -1))

    def points_px(self) -> tuple[Float[Tensor, "rows 21 2"], Float[Tensor, "rows 21 2"]]:
        """Points at the time of the frames, and their derivative in the lag: a cubic through four frames (Catmull and
        Rom 1974). NaN for missing ones."""
        whole, value, slope = self._weights()
        frames = whole + torch.arange(_AROUND - 1, _AROUND + 3, device=whole.device)
        own = self.around_px.index_select(1, frames)
        value, slope = (part.to(own)[:, None, None] for part in (value, slope))
        return (value * own).sum(1), (slope * own).sum(1)

    def noise(self) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """Standard deviation of these points over that of a frame's own, and its derivative in the lag: between frames
        the errors of several average out, which is no sign that the pictures are late."""
        _, value, slope = self._weights()
        size = value.norm()
        return size.to(self.lag), ((value @ slope) / size).to(self.lag)

    def _weights(self) -> tuple[Int[Tensor, ""], Float[Tensor, "4"], Float[Tensor, "4"]]:
        """Whole frames of the lag, what the four frames around it count, and the derivatives of that."""
        lag = self.lag.double().clamp(-MAX_LAG, MAX_LAG - 1e-9)
        whole = lag.floor()
        x = lag - whole
        value = (-x + 2 * x**2 - x**3, 2 - 5 * x**2 + 3 * x**3, x + 4 * x**2 - 3 * x**3, -(x**2) + x**3)
        slope = (-1 + 4 * x - 3 * x**2, -10 * x + 9 * x**2, 1 + 8 * x - 9 * x**2, -2 * x + 3 * x**2)
        return whole.long(), 0.5 * torch.stack(value), 0.5 * torch.stack(slope)


def _around(points_px: Float[Tensor, "frames 21 2"]) -> Float[Tensor, "frames window 21 2"]:
    """Points of the frames around each; where one is missing, that of the frame next to it towards the middle."""
    count, frames = len(points_px), torch.arange(len(points_px), device=points_px.device)
    window = [points_px]
    for side in (-1, 1):
        last = points_px
        for step in range(1, _AROUND + 1):
            there = frames + side * step
            own = points_px[there.clamp(0, count - 1)]
            is_known = own.isfinite().all(-1, keepdim=True) & ((there >= 0) & (there < count))[:, None, None]
            last = torch.where(is_known, own, last)
            window = [last, *window] if side < 0 else [*window, last]
    return torch.stack(window, 1)
