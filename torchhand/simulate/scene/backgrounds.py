"""What a simulated camera sees behind the hand: seeded pictures of six kinds."""

from collections.abc import Callable
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from torchhand.simulate.scene.room import room_picture

BackgroundKind = Literal["plain", "dark", "wall", "clutter", "blue", "room"]

_CLUTTER_SHAPES = 90


def background_picture(
    kind: BackgroundKind, width: int, height: int, generator: torch.Generator
) -> UInt8[Tensor, "height width 3"]:
    """An RGB picture.

    plain: one cool colour; dark: nearly black; wall: a warm bright wall, unevenly lit, its colour near that of skin;
    clutter: overlapping shapes of all colours, skin's among them, with strong edges everywhere; blue: the boards of
    the frame of Ueda et al. 2003, for a chroma key; room: a wall with window, shelf and pictures behind a sofa, out of
    focus, in cool light, as a webcam sees a room behind a hand.
    """
    if kind not in BACKGROUNDS:
        raise ValueError(f"background: expected one of {', '.join(BACKGROUNDS)}, got {kind!r}")
    seed = int(torch.randint(0, 2**31 - 1, (), generator=generator))
    picture = BACKGROUNDS[kind](width, height, np.random.default_rng(seed))
    return torch.from_numpy(np.clip(np.round(picture), 0, 255).astype(np.uint8))


def _plain(width: int, height: int, chance: np.random.Generator) -> np.ndarray:
    return np.full((height, width, 3), (96.0, 128.0, 150.0))


def _dark(width: int, height: int, chance: np.random.Generator) -> np.ndarray:
    return np.full((height, width, 3), (24.0, 25.0, 28.0))


def _wall(width: int, height: int, chance: np.random.Generator) -> np.ndarray:
    y, x = np.mgrid[0:height, 0:width]
    slope = chance.uniform(-0.12, 0.12, 2)
    light = 1 + slope[0] * (2 * x / width - 1) + slope[1] * (2 * y / height - 1)
    plaster = cv2.GaussianBlur(chance.normal(0, 1, (height, width)), (0, 0), 1.2)
    spots = cv2.GaussianBlur(chance.normal(0, 1, (height, width)), (0, 0), 0.06 * width)
    light = light + 0.03 * plaster + 0.02 * spots / max(float(spots.std()), 1e-9)
    return np.array((206.0, 198.0, 182.0)) * light[..., None]


def _clutter(width: int, height: int, chance: np.random.Generator) -> np.ndarray:
    picture = np.full((height, width, 3), (90, 100, 95), dtype=np.uint8)
    size = max(width, height)
    for _ in range(_CLUTTER_SHAPES):
        colour = chance.uniform(15, 245, 3)
        if chance.random() < 0.2:  # about the colour of skin
            colour = np.array((215.0, 165.0, 135.0)) * chance.uniform(0.5, 1.1)
        rgb = tuple(int(min(c, 255)) for c in colour)
        centre = (int(chance.integers(0, width)), int(chance.integers(0, height)))
        reach = chance.uniform(0.02, 0.16, 2) * size
        angle = float(chance.uniform(0, 180))
        if chance.random() < 0.5:
            cv2.ellipse(picture, centre, (int(reach[0]) + 2, int(reach[1]) + 2), angle, 0, 360, rgb, -1, cv2.LINE_AA)
        else:
            corners = cv2.boxPoints((centre, (2 * reach[0], 2 * reach[1]), angle))
            cv2.fillConvexPoly(picture, np.round(corners).astype(np.int32), rgb, cv2.LINE_AA)
    return cv2.GaussianBlur(picture, (0, 0), 0.7).astype(np.float64)


def _blue(width: int, height: int, chance: np.random.Generator) -> np.ndarray:
    y, x = np.mgrid[0:height, 0:width]
    slope = chance.uniform(-0.1, 0.1, 2)
    light = 1 + slope[0] * (2 * x / width - 1) + slope[1] * (2 * y / height - 1)
    return np.array((28.0, 62.0, 190.0)) * light[..., None]


BACKGROUNDS: dict[BackgroundKind, Callable[[int, int, np.random.Generator], np.ndarray]] = {
    "plain": _plain,
    "dark": _dark,
    "wall": _wall,
    "clutter": _clutter,
    "blue": _blue,
    "room": room_picture,
}
