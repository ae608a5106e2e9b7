"""A hand drawn with lines, whose fingers are known."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
import torch

# An open hand in palm radii about the palm's centre: where each digit leaves the palm, and the middle of its round end.
BASES = ((-1.36, 0.58), (-0.71, -1.28), (0.0, -1.30), (0.57, -1.11), (1.14, -0.86))
ENDS = ((-2.55, -0.22), (-1.08, -2.75), (0.0, -3.1), (0.86, -2.76), (1.62, -1.95))
WIDTH = 0.44


def _drawn(
    *, turn_deg: float = 0.0, mirrored: bool = False, without: tuple[int, ...] = (), palm: float = 40.0
) -> tuple[torch.Tensor, np.ndarray]:
    """Mask of a drawn hand with its arm, thumb on the left unless mirrored, and the tips (5, 2)."""
    side = round(10 * palm)
    canvas = np.zeros((side, side), np.uint8)
    turn = np.deg2rad(turn_deg)
    rotation = np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))))

    def put(x: float, y: float) -> np.ndarray:
        return side / 2 + palm * rotation @ np.array((-x if mirrored else x, y))

    def line(a: np.ndarray, b: np.ndarray, width: float) -> None:
        ends = [tuple(int(v) for v in np.rint(point)) for point in (a, b)]
        cv2.line(canvas, ends[0], ends[1], 1, max(1, round(width * palm)))

    corners = np.array([put(*base) for base in BASES] + [put(0.75, 1.2), put(-0.75, 1.2)])
    cv2.fillPoly(canvas, [cv2.convexHull(np.rint(corners).astype(np.int32))], 1)
    line(put(0, 0), put(0, 3.2), 1.4)
    tips = []
    for number, (base, end) in enumerate(zip(BASES, ENDS, strict=True)):
        along = np.array(end) - base
        along = along / np.hypot(*along)
        tips.append(put(*(np.array(end) + 0.5 * WIDTH * along)))
        if number not in without:
            line(put(*(np.array(base) - 0.3 * along)), put(*end), WIDTH)
    return torch.from_numpy(canvas > 0), np.array(tips)


@pytest.fixture
def drawn() -> Callable[..., tuple[torch.Tensor, np.ndarray]]:
    """Draws the hand: turned, mirrored, without some digits, of another size."""
    return _drawn


@pytest.fixture
def plan() -> tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]:
    """Where the digits leave the palm, and the middles of their round ends, palm radii, thumb on the left."""
    return BASES, ENDS
