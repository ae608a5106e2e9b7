"""A line chart as a picture, drawn with OpenCV."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

LINE_COLOURS = ((38, 98, 190), (214, 84, 48), (46, 140, 72), (150, 80, 160), (176, 134, 20), (110, 118, 130))
"""RGB, line by line."""

Number = int | float
Point = tuple[Number, Number]
Place = Callable[[Number, Number], Point]
"""Pixel of a value of x and one of y."""
Colour = tuple[int, int, int]

_PAPER, _INK, _GRID = (255, 255, 255), (60, 60, 60), (225, 225, 225)
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 18, 34, 62  # px around the field
_FONT, _SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.42
_TICKS = 5
_NAME_GAP = 16  # px
_DASH_PX = 8
_DOT_PX = 3
_PALE = 0.8  # share of the paper's colour in a band's
_SHIFT = 4  # fractional bits of OpenCV's coordinates


@dataclass(frozen=True)
class Axes:
    """What the axes of a chart mean, and how large it is."""

    title: str
    """Name of the chart and of what goes up in it."""
    x_name: str = ""
    y_end: Number | None = None
    """Where the upward axis ends; where the largest value wants it, if not given."""
    size_px: tuple[int, int] = (480, 320)
    """Width and height of the picture; 160x120 or more."""

    def __post_init__(self) -> None:
        if self.size_px[0] < 160 or self.size_px[1] < 120:
            raise ValueError(f"size: expected at least 160x120 px, got {self.size_px[0]}x{self.size_px[1]}")


def draw_chart(
    axes: Axes,
    x: Sequence[Number],
    lines: Mapping[str, Sequence[Number]],
    *,
    levels: Mapping[str, Number] | None = None,
    bands: Mapping[str, tuple[Sequence[Number], Sequence[Number]]] | None = None,
    has_dots: bool = False,
) -> UInt8[Tensor, "height width 3"]:
    """Lines over x from zero up, RGB, and `levels` as dashed horizontal lines. Values that are not finite are left out.

    Every line and level is named below, in its colour. bands: by the name of a line, lower and upper ends of a pale
    band behind it. has_dots: marks the values.
    """
    for name, values in lines.items():
        if len(values) != len(x):
            raise ValueError(f"{name}: expected {len(x)} values, as many as x has, got {len(values)}")
    for name, ends in (bands or {}).items():
        if name not in lines or any(len(values) != len(x) for values in ends):
            raise ValueError(f"band of {name!r}: expected a line of that name, and {len(x)} values at either end")
    levels, (width, height) = levels or {}, axes.size_px
    canvas = np.full((height, width, 3), _PAPER, dtype=np.uint8)
    x_end = _largest(x)
    y_largest = _largest([value for values in (*lines.values(), levels.values()) for value in values])
    y_step = tick_step(axes.y_end or y_largest)
    y_top = axes.y_end or y_step * math.ceil(y_largest / y_step - 1e-9)

    def place(px: Number, py: Number) -> Point:
        across, up = px / x_end, min(py / y_top, 1.0)
        return _LEFT + across * (width - _LEFT - _RIGHT), height - _BOTTOM - up * (height - _TOP - _BOTTOM)

    def corners(values: Sequence[Number]) -> list[Point]:
        return [place(px, py) for px, py in zip(x, values, strict=True) if math.isfinite(px) and math.isfinite(py)]

    colours = dict(zip(lines, _cycled(len(lines)), strict=True))
    for name, (low, high) in (bands or {}).items():
        pale = tuple(round(_PALE * paper + (1 - _PALE) * c) for paper, c in zip(_PAPER, colours[name], strict=True))
        cv2.fillPoly(canvas, [_fixed(corners(low) + corners(high)[::-1])], pale, cv2.LINE_AA, _SHIFT)
    _draw_axes(canvas, place, x_end, y_top, y_step, axes)
    at = float(_LEFT)
    for name, values in reversed(list(lines.items())):  # the first on top
        cv2.polylines(canvas, [_fixed(corners(values))], False, colours[name], 2, cv2.LINE_AA, _SHIFT)
        for corner in corners(values) if has_dots else []:
            cv2.circle(canvas, _whole(corner), _DOT_PX, colours[name], -1, cv2.LINE_AA)
    for name in lines:
        at = _name(canvas, name, colours[name], at)
    for colour, (name, level) in zip(_cycled(len(levels), len(lines)), levels.items(), strict=True):
        if math.isfinite(level):
            _draw_dashes(canvas, place(0, level), place(x_end, level), colour)
            at = _name(canvas, name, colour, at)
    return torch.from_numpy(canvas)


def tick_step(largest: Number) -> Number:
    """1, 2 or 5 times a power of ten, such that about five steps reach the largest value."""
    rough = largest / _TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough * (1 - 1e-9))


def _largest(values: Sequence[Number]) -> Number:
    """Largest number of those that are finite; 1 where none is above 0."""
    largest = max((value for value in values if math.isfinite(value)), default=0.0)
    return largest if largest > 0 else 1.0


def _draw_axes(canvas: np.ndarray, place: Place, x_end: Number, y_end: Number, y_step: Number, axes: Axes) -> None:
    height, width = canvas.shape[:2]
    x_step = tick_step(x_end)
    for tick in np.arange(0, y_end + 0.5 * y_step, y_step):
        start, end = place(0, tick), place(x_end, tick)
        cv2.line(canvas, _whole(start), _whole(end), _GRID if tick else _INK, 1)
        _text(canvas, f"{tick:g}", start[0] - 8, start[1] + 4, align=1.0)
    for tick in np.arange(0, x_end + 1e-6 * x_step, x_step):
        at = place(tick, 0)
        cv2.line(canvas, _whole(at), _whole((at[0], at[1] + 4)), _INK, 1)
        _text(canvas, f"{tick:g}", at[0], at[1] + 18, align=0.5)
    _text(canvas, axes.title, _LEFT, 20, align=0.0)
    _text(canvas, axes.x_name, width - _RIGHT, height - 26, align=1.0)


def _draw_dashes(canvas: np.ndarray, start: Point, end: Point, colour: Colour) -> None:
    for left in range(round(start[0]), round(end[0]), 2 * _DASH_PX):
        right = min(left + _DASH_PX, round(end[0]))
        cv2.line(canvas, (left, round(start[1])), (right, round(start[1])), colour, 2)


def _name(canvas: np.ndarray, name: str, colour: Colour, at: float) -> float:
    """Writes the name of a line below the field from `at` on; returns where the next one begins."""
    return at + _NAME_GAP + _text(canvas, name, at, canvas.shape[0] - 8, align=0.0, colour=colour)


def _text(canvas: np.ndarray, text: str, x: Number, y: Number, *, align: float, colour: Colour = _INK) -> int:
    """Writes text and returns its length, px. align: 0 begins at x, 1 ends there."""
    length = cv2.getTextSize(text, _FONT, _SCALE, 1)[0][0]
    cv2.putText(canvas, text, _whole((x - align * length, y)), _FONT, _SCALE, colour, 1, cv2.LINE_AA)
    return length


def _cycled(count: int, start: int = 0) -> list[Colour]:
    return [LINE_COLOURS[(start + i) % len(LINE_COLOURS)] for i in range(count)]


def _whole(point: Point) -> tuple[int, int]:
    return round(point[0]), round(point[1])


def _fixed(corners: list[Point]) -> np.ndarray:
    return np.rint(np.asarray(corners, dtype=np.float64).reshape(-1, 1, 2) * (1 << _SHIFT)).astype(np.int32)
