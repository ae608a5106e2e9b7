"""Pictures of several recorded cameras paired by the times at which they were taken, for cameras of any rates."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

_ROUNDING_S = 1e-3  # of the times in containers
_LONE = 0.75  # intervals without a picture of the slowest camera, after which another's picture is a frame of its own


@dataclass(frozen=True, kw_only=True)
class PairedTimes:
    """Frames, and which picture of every camera is of their time."""

    time_s: Float64[np.ndarray, "frames"]
    """Times of the frames, seconds, growing."""
    numbers: Int64[np.ndarray, "frames views"]
    """Number of each camera's picture, counted from 0; -1 where it has none of that time."""
    apart_s: Float64[np.ndarray, "frames views"]
    """Times from a frame to its pictures, seconds; NaN where there is none."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def fps(self) -> float:
        """Mean rate; 0 for a single frame."""
        return mean_rate(self.time_s)

    @cached_property
    def furthest_s(self) -> float:
        """Largest difference from a frame's time to one of its pictures."""
        return float(np.nanmax(np.abs(self.apart_s)))

    def every(self, step: int) -> "PairedTimes":
        """Each `step`-th frame."""
        return PairedTimes(time_s=self.time_s[::step], numbers=self.numbers[::step], apart_s=self.apart_s[::step])


def pair_times(times_s: Sequence[Float64[np.ndarray, "_"]]) -> PairedTimes:
    """The frames of cameras of which each has taken pictures at these times, seconds, growing.

    A frame is a picture of the slowest camera, and, where that has a gap, of others. Each of the other cameras adds
    the picture nearest to it, half an interval of its mean rate away at most; no picture is in two frames. Frames
    begin with the camera that begins last, and end with the one that ends first. Raises ValueError where there are
    none: the cameras' times have nothing in common.
    """
    steps = [_mean_step(times) for times in times_s]
    begin = max(times[0] - 0.5 * step for times, step in zip(times_s, steps, strict=True))
    end = min(times[-1] + 0.5 * step for times, step in zip(times_s, steps, strict=True))
    order = sorted(range(len(times_s)), key=lambda view: -steps[view])
    frames = times_s[order[0]]
    for view in order[1:]:
        frames = _with_lone(frames, times_s[view], _LONE * steps[order[0]])
    frames = frames[(frames >= begin) & (frames <= end)]
    if not len(frames):
        raise ValueError("the cameras' times have nothing in common")
    numbers = np.stack(
        [_nearest(frames, times, 0.5 * step + _ROUNDING_S) for times, step in zip(times_s, steps, strict=True)], 1
    )
    taken_s = np.stack([times[numbers[:, view]] for view, times in enumerate(times_s)], 1)
    apart_s = np.where(numbers < 0, np.nan, taken_s - frames[:, None])
    return PairedTimes(time_s=frames - frames[0], numbers=numbers, apart_s=apart_s)


def is_constant(times_s: Float64[np.ndarray, "_"], fps: float) -> bool:
    """Whether these times, the first of which is 0, are those of a rate, to a quarter of a frame."""
    return bool((np.abs(times_s * fps - np.arange(len(times_s))) <= 0.25).all())


def mean_rate(times_s: Float64[np.ndarray, "_"]) -> float:
    """Pictures per second; 0 for a single one."""
    step = _mean_step(times_s)
    return 1 / step if step else 0.0


def _mean_step(times_s: Float64[np.ndarray, "_"]) -> float:
    return float(times_s[-1] - times_s[0]) / max(1, len(times_s) - 1)


def _with_lone(
    frames: Float64[np.ndarray, "_"], times_s: Float64[np.ndarray, "_"], lone_s: float
) -> Float64[np.ndarray, "_"]:
    """The frames and those of these times that are further than this from all frames, and from one another."""
    after = np.searchsorted(frames, times_s)
    to_before = times_s - frames[(after - 1).clip(0)]
    to_after = frames[after.clip(max=len(frames) - 1)] - times_s
    is_inside = (after > 0) & (after < len(frames))
    added: list[float] = []
    for time_s in times_s[is_inside & (np.minimum(to_before, to_after) >= lone_s)]:
        if not added or time_s - added[-1] >= lone_s:
            added.append(float(time_s))
    return np.sort(np.concatenate((frames, added)))


def _nearest(
    frames: Float64[np.ndarray, "frames"], times_s: Float64[np.ndarray, "_"], reach_s: float
) -> Int64[np.ndarray, "frames"]:
    """The nearest of these times within reach of each frame, given to one frame alone; -1 where there is none."""
    after = np.searchsorted(times_s, frames).clip(1, max(1, len(times_s) - 1)).clip(max=len(times_s) - 1)
    before = (after - 1).clip(0)
    number = np.where(np.abs(frames - times_s[before]) <= np.abs(times_s[after] - frames), before, after)
    apart = np.abs(times_s[number] - frames)
    number = np.where(apart <= reach_s, number, -1)
    order = np.lexsort((apart, number))  # of the frames that want one picture, the nearest comes first
    is_again = np.concatenate(([False], np.diff(number[order]) == 0))
    number[order[is_again]] = -1
    return number.astype(np.int64)
