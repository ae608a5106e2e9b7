"""Axis, ends and widths of one finger to a fraction of a pixel, from cross-sections of a smoothed silhouette."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

_STEP_PX = 0.5  # between samples across and along
_REACH = 1.6  # cross-sections reach so far to either side, finger widths
_SHAFT = (0.1, 0.85)  # stretch between base and tip in which the axis is fitted
_ROUNDS = 3


@dataclass(frozen=True, kw_only=True)
class FingerProfile:
    """One finger's axis in the picture; px, (x, y)."""

    tip: Float[np.ndarray, "2"]
    """Point where the axis leaves the silhouette."""
    direction: Float[np.ndarray, "2"]
    """Unit vector from base to tip."""
    along: Float[np.ndarray, "samples"]
    """Distances from the tip, towards the base, of the cross-sections."""
    width: Float[np.ndarray, "samples"]
    """Widths at the steps along the axis; NaN where a side does not end within reach."""
    straightness: float
    """Root mean square distance of the middles of the cross-sections from the axis, over the median width."""


def finger_profile(
    plane: Float[np.ndarray, "height width"], tip: tuple[float, float], base: tuple[float, float], width: float
) -> FingerProfile | None:
    """The finger between two rough ends, in a silhouette smoothed to 0..1 (inside 1); None where there is none."""
    end, start = np.array(tip), np.array(base)
    middles, widths = np.zeros(0), np.zeros(0)
    along = np.zeros(0)
    for _ in range(_ROUNDS):
        length = float(np.hypot(*(end - start)))
        if length < 2.0:
            return None
        direction = (end - start) / length
        along = np.arange(0.0, length, _STEP_PX)
        left, right = _sides(plane, start + along[:, None] * direction, direction, _REACH * width)
        middles, widths = 0.5 * (right + left), right - left
        shaft = (along > _SHAFT[0] * length) & (along < _SHAFT[1] * length) & np.isfinite(widths)
        shaft &= widths < 1.6 * np.nanmedian(widths) if shaft.any() else False
        if shaft.sum() < 4:
            return None
        slope, offset = _line(along[shaft], middles[shaft])
        across = np.array((-direction[1], direction[0]))
        start, end = start + offset * across, start + length * direction + (offset + slope * length) * across
        exit_at = _exit(plane, 0.5 * (start + end), (end - start) / np.hypot(*(end - start)), 1.5 * length)
        if exit_at is None:
            return None
        end = exit_at
    length = float(np.hypot(*(end - start)))
    direction = (end - start) / length
    along = np.arange(0.0, length, _STEP_PX)
    left, right = _sides(plane, end - along[:, None] * direction, direction, _REACH * width)
    middles, widths = 0.5 * (right + left), right - left
    shaft = (along > (1 - _SHAFT[1]) * length) & (along < (1 - _SHAFT[0]) * length) & np.isfinite(widths)
    if not shaft.any():
        return None
    return FingerProfile(
        tip=end,
        direction=direction,
        along=along,
        width=widths,
        straightness=float(np.sqrt(np.mean(middles[shaft] ** 2)) / np.median(widths[shaft])),
    )


def _sides(
    plane: np.ndarray, centres: np.ndarray, direction: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances from the axis at which the silhouette ends to either side, NaN where it does not."""
    across = np.array((-direction[1], direction[0]))
    steps = np.arange(0.0, reach + _STEP_PX, _STEP_PX)
    ends = []
    for sign in (-1.0, 1.0):
        places = centres[:, None] + sign * steps[:, None] * across
        values = sampled(plane, places)
        ends.append(sign * _first_below(values, steps))
    return ends[0], ends[1]


def _exit(plane: np.ndarray, start: np.ndarray, direction: np.ndarray, reach: float) -> np.ndarray | None:
    steps = np.arange(0.0, reach, _STEP_PX)
    distance = _first_below(sampled(plane, start + steps[:, None] * direction)[None], steps)[0]
    return None if not np.isfinite(distance) else start + distance * direction


def _first_below(values: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Where each row first falls below one half, between samples; NaN where it starts below or never does."""
    below = values < 0.5
    index = below.argmax(1)
    rows = np.arange(len(values))
    before, after = values[rows, np.maximum(index - 1, 0)], values[rows, index]
    fraction = (before - 0.5) / np.maximum(before - after, 1e-9)
    found = below.any(1) & (index > 0)
    return np.where(found, steps[np.maximum(index - 1, 0)] + fraction * _STEP_PX, np.nan)


def sampled(plane: Float[np.ndarray, "height width"], places: Float[np.ndarray, "*points 2"]) -> np.ndarray:
    """Bilinear values at points (x, y); 0 beyond the picture."""
    flat = places.reshape(1, -1, 2).astype(np.float32)
    values = [
        cv2.remap(plane, flat[:, i : i + 16384, 0], flat[:, i : i + 16384, 1], cv2.INTER_LINEAR, borderValue=0.0)
        for i in range(0, flat.shape[1], 16384)
    ]
    return np.concatenate(values, 1).reshape(places.shape[:-1])


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope and offset of a robust line: least squares, twice without what lies far off."""
    keep = np.ones(len(x), bool)
    slope = offset = 0.0
    for _ in range(3):
        slope, offset = (float(value) for value in np.polyfit(x[keep], y[keep], 1))
        away = np.abs(y - slope * x - offset)
        keep = away <= max(2.5 * float(np.median(away)), 0.5)
    return slope, offset
