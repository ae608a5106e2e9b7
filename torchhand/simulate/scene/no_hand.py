"""Pictures that show no hand but what may be taken for one: faces, portraits, walls, tables, furniture, textures."""

from collections.abc import Callable
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from torchhand.simulate.scene.backgrounds import BACKGROUNDS, BackgroundKind

NoHandKind = Literal["face", "portrait", "arm", "wall", "table", "furniture", "texture", "things"]

Colour = tuple[float, float, float]
_BEHIND: tuple[BackgroundKind, ...] = ("plain", "dark", "wall", "clutter", "blue")
_SKINS = ((235, 181, 153), (209, 150, 117), (156, 105, 77), (102, 66, 48))
_HAIR = ((40, 30, 25), (90, 60, 40), (150, 110, 70), (190, 190, 185), (20, 20, 22))
_WOODS = ((196, 150, 104), (222, 184, 135), (160, 110, 70), (120, 78, 50), (235, 205, 165))
_SHIFT = 4  # fractional bits of OpenCV's coordinates


def picture_without_hand(
    kind: NoHandKind, width: int, height: int, generator: torch.Generator
) -> UInt8[Tensor, "height width 3"]:
    """An RGB picture of one of NO_HAND: a face, with or without neck and hair; a portrait with bare shoulders; a bare
    forearm or upper arm whose hand is outside the picture or in a sleeve; a wall with door or pictures; a table of
    wood with things on it; chairs and shelves whose legs are about as thick as fingers; textures; overlapping things
    of all colours, skin's among them."""
    if kind not in NO_HAND:
        raise ValueError(f"kind: expected one of {', '.join(NO_HAND)}, got {kind!r}")
    chance = np.random.default_rng(int(torch.randint(0, 2**31 - 1, (), generator=generator)))
    canvas = _Canvas(width, height, chance)
    NO_HAND[kind](canvas)
    return torch.from_numpy(canvas.photographed())


class _Canvas:
    """A picture that is painted on; lengths are shares of its height."""

    def __init__(self, width: int, height: int, chance: np.random.Generator) -> None:
        self.width, self.height, self.chance = width, height, chance
        self.pixels = np.zeros((height, width, 3), np.float64)

    def behind(self, *names: BackgroundKind) -> None:
        """One of some backgrounds of simulated hands."""
        some: list[BackgroundKind] = [name for name in _BEHIND if not names or name in names]
        pick = some[int(self.chance.integers(len(some)))]
        self.pixels[:] = BACKGROUNDS[pick](self.width, self.height, self.chance)
        if self.chance.random() < 0.5:
            self.pixels *= self.chance.uniform(0.5, 1.1, 3)

    def colour(self, table: tuple[Colour, ...] | tuple[tuple[int, int, int], ...]) -> np.ndarray:
        own = np.array(table[int(self.chance.integers(len(table)))], np.float64)
        return own * self.chance.uniform(0.85, 1.1) + self.chance.normal(0, 4, 3)

    def middle(self, spread: float = 0.12) -> np.ndarray:
        """Somewhere about the middle, px."""
        return np.array((0.5 * self.width, 0.5 * self.height)) + spread * self.height * self.chance.normal(0, 1, 2)

    def fill(self, mask: np.ndarray, colour: np.ndarray, *, shade: float = 0.12) -> None:
        """Paint where the mask (0..255) is, unevenly lit; rounded things are darker at their edges."""
        share = mask.astype(np.float64)[..., None] / 255
        soft = max(2.0, 0.04 * self.height)
        light = cv2.GaussianBlur(self.chance.normal(0, 1, mask.shape), (0, 0), 2 * soft)
        light = 1 + shade * light / max(float(light.std()), 1e-9)
        rim = cv2.GaussianBlur(mask.astype(np.float64) / 255, (0, 0), soft)
        light = light * (0.75 + 0.25 * np.clip(2 * rim - 0.6, 0, 1))
        self.pixels = (1 - share) * self.pixels + share * colour * light[..., None]

    def ellipse(self, centre: np.ndarray, axes: tuple[float, float], turn_deg: float = 0.0) -> np.ndarray:
        """A mask. axes: shares of the height."""
        mask = np.zeros((self.height, self.width), np.uint8)
        place = tuple(round(float(c) * (1 << _SHIFT)) for c in centre)
        half = tuple(max(1, round(a * self.height * (1 << _SHIFT))) for a in axes)
        cv2.ellipse(mask, place, half, turn_deg, 0, 360, 255, -1, cv2.LINE_AA, _SHIFT)
        return mask

    def polygon(self, corners: np.ndarray) -> np.ndarray:
        mask = np.zeros((self.height, self.width), np.uint8)
        cv2.fillPoly(mask, [np.round(corners * (1 << _SHIFT)).astype(np.int32)], 255, cv2.LINE_AA, _SHIFT)
        return mask

    def bar(self, start: np.ndarray, end: np.ndarray, first: float, last: float) -> np.ndarray:
        """A mask of a bar whose breadth goes from one share of the height to another, with rounded ends."""
        along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
        across = np.array((-along[1], along[0])) * 0.5 * self.height
        mask = self.polygon(
            np.stack((start - first * across, end - last * across, end + last * across, start + first * across))
        )
        for place, breadth in ((start, first), (end, last)):
            mask = np.maximum(mask, self.ellipse(place, (0.5 * breadth, 0.5 * breadth)))
        return mask

    def photographed(self) -> UInt8[np.ndarray, "height width 3"]:
        """With the lens's blur, some light and the sensor's noise."""
        blurred = cv2.GaussianBlur(self.pixels, (0, 0), self.chance.uniform(0.5, 1.2))
        lit = blurred * self.chance.uniform(0.75, 1.1) + self.chance.normal(0, self.chance.uniform(1, 4), blurred.shape)
        return np.clip(np.round(lit), 0, 255).astype(np.uint8)


def _head(canvas: _Canvas, middle: np.ndarray, size: float, skin: np.ndarray) -> None:
    """A head of that height with hair, eyes, mouth and ears."""
    chance, px = canvas.chance, size * canvas.height
    hair, turn = canvas.colour(_HAIR), chance.uniform(-15, 15)
    if chance.random() < 0.75:
        back = chance.uniform(1.0, 1.35)
        canvas.fill(canvas.ellipse(middle - (0, 0.12 * px), (0.42 * size * back, 0.55 * size * back), turn), hair)
    for side in (-1, 1):
        canvas.fill(canvas.ellipse(middle + (side * 0.37 * px, 0), (0.06 * size, 0.11 * size), turn), 0.9 * skin)
    canvas.fill(canvas.ellipse(middle, (0.37 * size, 0.5 * size), turn), skin)
    if chance.random() < 0.6:
        canvas.fill(canvas.ellipse(middle - (0, 0.42 * px), (0.34 * size, 0.16 * size), turn), hair)
    for side in (-1, 1):
        eye = middle + (side * 0.15 * px, -0.08 * px)
        canvas.fill(canvas.ellipse(eye, (0.06 * size, 0.03 * size)), np.array((225.0, 222.0, 218.0)))
        canvas.fill(canvas.ellipse(eye, (0.028 * size, 0.028 * size)), np.array((45.0, 35.0, 30.0)))
        canvas.fill(canvas.ellipse(eye - (0, 0.075 * px), (0.085 * size, 0.013 * size)), 0.8 * hair)
    canvas.fill(canvas.ellipse(middle + (0, 0.08 * px), (0.035 * size, 0.1 * size)), 0.93 * skin)
    canvas.fill(canvas.ellipse(middle + (0, 0.25 * px), (0.12 * size, 0.03 * size)), skin * (0.85, 0.6, 0.6))


def _face(canvas: _Canvas) -> None:
    canvas.behind()
    skin, size, middle = canvas.colour(_SKINS), canvas.chance.uniform(0.3, 0.8), canvas.middle()
    if canvas.chance.random() < 0.6:
        neck = middle + (0, 0.9 * size * canvas.height)
        canvas.fill(canvas.bar(middle, neck, 0.42 * size, 0.5 * size), 0.9 * skin)
    _head(canvas, middle, size, skin)


def _portrait(canvas: _Canvas) -> None:
    canvas.behind()
    chance, skin, size = canvas.chance, canvas.colour(_SKINS), canvas.chance.uniform(0.25, 0.5)
    middle = canvas.middle(0.08) - (0, 0.15 * canvas.height)
    px = size * canvas.height
    shoulders = middle + (0, 1.35 * px)
    cloth = canvas.colour(_SKINS) if chance.random() < 0.4 else chance.uniform(20, 235, 3)
    canvas.fill(canvas.ellipse(shoulders + (0, 0.55 * px), (1.0 * size, 0.8 * size)), cloth)
    canvas.fill(canvas.bar(middle, shoulders, 0.42 * size, 0.55 * size), 0.9 * skin)
    for side in (-1, 1):
        if chance.random() < 0.5:  # bare arms that hang down
            top = shoulders + (side * 0.85 * px, 0.25 * px)
            canvas.fill(canvas.bar(top, top + (side * 0.1 * px, 2.5 * px), 0.3 * size, 0.24 * size), skin)
    _head(canvas, middle, size, skin)


def _arm(canvas: _Canvas) -> None:
    canvas.behind()
    chance, skin = canvas.chance, canvas.colour(_SKINS)
    turn, reach = chance.uniform(0, 2 * np.pi), np.hypot(canvas.width, canvas.height)
    middle, along = canvas.middle(), np.array((np.cos(turn), np.sin(turn)))
    broad = chance.uniform(0.12, 0.28)
    canvas.fill(canvas.bar(middle - reach * along, middle + reach * along, broad, 0.75 * broad), skin)
    if chance.random() < 0.5:  # the hand is in a sleeve or a glove
        start = middle + chance.uniform(-0.1, 0.3) * canvas.height * along
        canvas.fill(canvas.bar(start, start + reach * along, 1.15 * broad, 1.3 * broad), chance.uniform(10, 240, 3))


def _wall(canvas: _Canvas) -> None:
    canvas.behind("plain", "wall", "dark")
    chance = canvas.chance
    if chance.random() < 0.5:
        canvas.pixels *= np.array((1.0, chance.uniform(0.75, 0.95), chance.uniform(0.6, 0.9)))
    for _ in range(int(chance.integers(0, 4))):  # doors, frames, switches
        corner, size = canvas.middle(0.4), canvas.height * chance.uniform(0.05, 0.7, 2)
        box = corner + np.array(((0, 0), (size[0], 0), (size[0], size[1]), (0, size[1])))
        canvas.fill(canvas.polygon(box), canvas.colour(_WOODS) if chance.random() < 0.5 else chance.uniform(10, 240, 3))


def _grain(canvas: _Canvas, colour: np.ndarray) -> None:
    """Boards of wood all over."""
    chance = canvas.chance
    y, x = np.mgrid[0 : canvas.height, 0 : canvas.width] / canvas.height
    turn = chance.uniform(0, np.pi)
    across, along = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    bend = 0.03 * np.sin(4 * along + chance.uniform(0, 6)) + 0.01 * np.sin(13 * along)
    rings = 0.5 + 0.5 * np.sin(chance.uniform(40, 160) * (across + bend))
    board = np.floor(across / chance.uniform(0.12, 0.4)).astype(int)
    tint = chance.uniform(0.8, 1.1, 64)[board % 64]
    canvas.pixels[:] = colour * (tint * (1 - 0.18 * rings))[..., None]


def _table(canvas: _Canvas) -> None:
    _grain(canvas, canvas.colour(_WOODS))
    chance = canvas.chance
    for _ in range(int(chance.integers(0, 6))):
        colour = canvas.colour(_SKINS) if chance.random() < 0.3 else chance.uniform(10, 245, 3)
        if chance.random() < 0.5:
            canvas.fill(canvas.ellipse(canvas.middle(0.3), tuple(chance.uniform(0.03, 0.2, 2)), 0), colour)
        else:
            start, end = canvas.middle(0.3), canvas.middle(0.3)
            canvas.fill(canvas.bar(start, end, chance.uniform(0.01, 0.06), chance.uniform(0.01, 0.06)), colour)


def _furniture(canvas: _Canvas) -> None:
    canvas.behind("plain", "wall", "dark", "blue")
    chance = canvas.chance
    colour = canvas.colour(_WOODS) if chance.random() < 0.6 else canvas.colour(_SKINS)
    middle, size = canvas.middle(0.08), chance.uniform(0.25, 0.5) * canvas.height
    half = 0.5 * size
    seat = middle + np.array(((-1.0, -0.15), (1.0, -0.15), (1.1, 0.2), (-1.1, 0.2))) * half
    canvas.fill(canvas.polygon(seat), colour)
    legs, thick = int(chance.integers(2, 7)), chance.uniform(0.02, 0.07)
    up = -1.0 if chance.random() < 0.4 else 1.0
    for place in np.linspace(-0.9, 0.9, legs):
        top = middle + (place * half, 0.1 * half * up)
        end = top + np.array((chance.uniform(-0.25, 0.25), chance.uniform(0.8, 2.0) * up)) * half
        canvas.fill(canvas.bar(top, end, thick, chance.uniform(0.6, 1.0) * thick), colour * chance.uniform(0.85, 1.05))


def _texture(canvas: _Canvas) -> None:
    chance, kind = canvas.chance, int(canvas.chance.integers(4))
    one, other = (canvas.colour(_SKINS if chance.random() < 0.5 else _WOODS) for _ in range(2))
    if kind == 0:
        _grain(canvas, one)
        return
    y, x = np.mgrid[0 : canvas.height, 0 : canvas.width] / canvas.height
    if kind == 1:  # stripes
        turn, period = chance.uniform(0, np.pi), chance.uniform(0.03, 0.2)
        share = np.sin(2 * np.pi * (x * np.cos(turn) + y * np.sin(turn)) / period) > chance.uniform(-0.6, 0.6)
    elif kind == 2:  # checks
        period = chance.uniform(0.05, 0.3)
        share = (np.floor(x / period) + np.floor(y / period)) % 2 > 0.5
    else:  # clouds
        noise = cv2.GaussianBlur(chance.normal(0, 1, x.shape), (0, 0), chance.uniform(0.01, 0.08) * canvas.height)
        share = noise > chance.uniform(-0.5, 0.8) * noise.std()
    canvas.pixels[:] = np.where(share[..., None], one, other if chance.random() < 0.4 else chance.uniform(10, 240, 3))


def _things(canvas: _Canvas) -> None:
    canvas.behind("clutter")


NO_HAND: dict[NoHandKind, Callable[[_Canvas], None]] = {
    "face": _face,
    "portrait": _portrait,
    "arm": _arm,
    "wall": _wall,
    "table": _table,
    "furniture": _furniture,
    "texture": _texture,
    "things": _things,
}
