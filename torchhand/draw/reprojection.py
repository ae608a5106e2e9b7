"""Picture of how well a camera's calibration explains the corners it saw."""

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

_PAPER, _INK, _FRAME = (255, 255, 255), (60, 60, 60), (190, 190, 190)
_COLD, _HOT = (38, 98, 190), (214, 60, 40)
_PANEL = 560  # px, the longer side of a panel
_EDGE, _HEAD = 12, 44  # px around and above a panel
_ARROW_FRACTION = 0.03  # length of an arrow of the root mean square error, relative to the panel
_CELLS = (8, 6)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SHIFT = 4  # fractional bits of OpenCV's coordinates


def draw_reprojection(
    title: str,
    points_px: Float[Tensor, "points 2"],
    residuals_px: Float[Tensor, "points 2"],
    width: int,
    height: int,
) -> UInt8[Tensor, "rows columns 3"]:
    """Left: every corner with its residual, enlarged, as an arrow. Right: where corners were seen, and how well.

    residuals: seen minus computed. On the right, cells of an 8 x 6 grid hold the number of their corners and are
    coloured from blue to red by their root mean square error, red where it is twice that of the whole picture or more;
    white cells saw none.
    """
    if not len(points_px):
        raise ValueError("points: expected one or more, got none")
    scale = _PANEL / max(width, height)
    panel = (max(1, round(width * scale)), max(1, round(height * scale)))
    canvas = np.full((panel[1] + _HEAD + _EDGE, 2 * panel[0] + 3 * _EDGE, 3), _PAPER, np.uint8)
    rms = float(residuals_px.square().sum(-1).mean().sqrt())
    gain = _ARROW_FRACTION * _PANEL / (scale * rms) if rms > 1e-9 else 1.0
    left, right = (_EDGE, _HEAD), (panel[0] + 2 * _EDGE, _HEAD)
    _draw_arrows(canvas, points_px, residuals_px, left, scale, gain, rms)
    _draw_cells(canvas, points_px, residuals_px, right, (width, height), panel, rms)
    for x, y in (left, right):
        cv2.rectangle(canvas, (x - 1, y - 1), (x + panel[0], y + panel[1]), _FRAME, 1)
    _text(canvas, f"{title}: {len(points_px)} corners, RMS {rms:.3f} px", left[0], 18)
    _text(canvas, f"seen - computed, {gain:.0f} times enlarged", left[0], 36)
    _text(canvas, "corners by place; blue: small errors, red: large", right[0], 36)
    return torch.from_numpy(canvas)


def _draw_arrows(
    canvas: np.ndarray,
    points: Tensor,
    residuals: Tensor,
    origin: tuple[int, int],
    scale: float,
    gain: float,
    rms: float,
) -> None:
    start = torch.tensor(origin) + (points + 0.5) * scale
    end = start + residuals * (scale * gain)
    for a, b, size in zip(start.tolist(), end.tolist(), residuals.norm(dim=-1).tolist(), strict=True):
        colour = _heat(size / (2 * rms) if rms > 1e-9 else 0.0)
        cv2.line(canvas, _fixed(a), _fixed(b), colour, 1, cv2.LINE_AA, _SHIFT)
        cv2.circle(canvas, _fixed(a), 2 << _SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)


def _draw_cells(
    canvas: np.ndarray,
    points: Tensor,
    residuals: Tensor,
    origin: tuple[int, int],
    size: tuple[int, int],
    panel: tuple[int, int],
    rms: float,
) -> None:
    counts = torch.tensor(_CELLS)
    cells = ((points + 0.5) / torch.tensor(size) * counts).long().clamp(torch.zeros(2).long(), counts - 1)
    for column in range(_CELLS[0]):
        for row in range(_CELLS[1]):
            inside = (cells == torch.tensor((column, row))).all(-1)
            if not bool(inside.any()):
                continue
            local = float(residuals[inside].square().sum(-1).mean().sqrt())
            x, y = (origin[i] + panel[i] * place / _CELLS[i] for i, place in enumerate((column, row)))
            low = (round(x), round(y))
            high = (round(x + panel[0] / _CELLS[0]) - 1, round(y + panel[1] / _CELLS[1]) - 1)
            cv2.rectangle(canvas, low, high, _heat(local / (2 * rms) if rms > 1e-9 else 0.0, pale=0.5), -1)
            _text(canvas, str(int(inside.sum())), low[0] + 6, (low[1] + high[1]) // 2 + 5)


def _heat(fraction: float, *, pale: float = 0.0) -> tuple[int, int, int]:
    """Colour from blue at 0 to red at 1 and above, mixed with white."""
    fraction = min(max(fraction, 0.0), 1.0)
    mixed = [(1 - fraction) * cold + fraction * hot for cold, hot in zip(_COLD, _HOT, strict=True)]
    r, g, b = (round((1 - pale) * value + pale * 255) for value in mixed)
    return r, g, b


def _text(canvas: np.ndarray, text: str, x: int, y: int) -> None:
    cv2.putText(canvas, text, (x, y), _FONT, 0.45, _INK, 1, cv2.LINE_AA)


def _fixed(point: list[float]) -> tuple[int, int]:
    """Numbers for OpenCV's coordinates with fractional bits, kept within what they hold."""
    x, y = (int(np.clip(round(value * (1 << _SHIFT)), -(1 << 24), 1 << 24)) for value in point)
    return x, y
