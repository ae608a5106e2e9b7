"""A room behind a simulated hand, as a webcam sees it: cool light from a window, out of focus."""

import cv2
import numpy as np

Box = tuple[float, float, float, float]
"""Left, top, right and bottom, shares of the picture's height."""

Colour = tuple[float, float, float]

_WALL: Colour = (148.0, 158.0, 166.0)
_FLOOR: Colour = (92.0, 98.0, 104.0)
_SKIRTING: Colour = (176.0, 182.0, 188.0)
_FRAME: Colour = (214.0, 220.0, 226.0)
_SKY: Colour = (206.0, 226.0, 244.0)
_TREES: Colour = (112.0, 140.0, 118.0)
_BOARD: Colour = (70.0, 74.0, 80.0)
_BOOKS: tuple[Colour, ...] = (
    (62.0, 82.0, 112.0),
    (70.0, 104.0, 100.0),
    (150.0, 158.0, 166.0),
    (96.0, 76.0, 108.0),
    (38.0, 46.0, 58.0),
)
_SOFA: Colour = (74.0, 98.0, 118.0)
_CUSHION: Colour = (126.0, 152.0, 156.0)
_BLUR = 0.011  # of what is out of focus, share of the height


def room_picture(width: int, height: int, chance: np.random.Generator) -> np.ndarray:
    """Grey levels (height, width, 3): a wall with a window, a picture and shelves behind a sofa. Nothing is of the
    colour of skin; edges and bright and dark areas cross what a hand in the middle covers."""
    room = _Room(width, height)
    window: Box = (left := 0.06 * room.aspect * (1 + chance.random()), 0.08, left + 0.4, 0.56)
    _wall(room, window)
    _window(room, window)
    shelf = room.aspect - 0.42 - 0.1 * chance.random()
    for bottom in (0.3, 0.56):
        _books(room, shelf, bottom, chance)
    frame = window[2] + 0.12
    if frame + 0.16 < shelf:
        room.fill((frame, 0.14, frame + 0.16, 0.36), (54.0, 58.0, 64.0))
        room.fill((frame + 0.012, 0.152, frame + 0.148, 0.348), (122.0, 146.0, 160.0), 0.8 + 0.6 * room.y)
    _sofa(room, 0.16 * room.aspect * chance.random(), chance)
    return room.photographed()


class _Room:
    """A picture that is painted from back to front."""

    def __init__(self, width: int, height: int) -> None:
        self.pixels = np.zeros((height, width, 3))
        self.y, self.x = np.mgrid[0:height, 0:width] / height
        self.aspect = width / height

    def fill(self, box: Box, colour: Colour, light: np.ndarray | float = 1.0, where: np.ndarray | bool = True) -> None:
        """Paint a box, or the part of it `where` it is wanted, under some light."""
        left, top, right, bottom = box
        inside = (self.x >= left) & (self.x < right) & (self.y >= top) & (self.y < bottom) & where
        self.pixels[inside] = np.broadcast_to(light, inside.shape)[inside][:, None] * np.asarray(colour)

    def photographed(self) -> np.ndarray:
        """Out of focus, darker towards the corners."""
        blurred = cv2.GaussianBlur(self.pixels, (0, 0), _BLUR * len(self.pixels))
        off_centre = (self.x / self.aspect - 0.5) ** 2 + (self.y - 0.5) ** 2
        return blurred * (1.04 - 0.32 * off_centre)[..., None]


def _wall(room: _Room, window: Box) -> None:
    floor = 0.87
    middle = 0.5 * (window[0] + window[2])
    glow = np.exp(-((room.x - middle) ** 2 + (room.y - 0.3) ** 2) / 0.9)  # beside the window
    room.fill((0.0, 0.0, room.aspect, floor), _WALL, 0.72 + 0.4 * glow)
    room.fill((0.0, floor, room.aspect, 1.0), _FLOOR, 0.9 + 0.3 * glow)
    room.fill((0.0, floor - 0.025, room.aspect, floor), _SKIRTING)


def _window(room: _Room, window: Box) -> None:
    left, top, right, bottom = window
    room.fill((left - 0.02, top - 0.02, right + 0.02, bottom + 0.02), _FRAME)
    room.fill(window, _SKY, 1.05 - 0.25 * room.y)
    tops = 0.43 + 0.03 * np.sin(14 * room.x) + 0.01 * np.sin(47 * room.x)
    room.fill(window, _TREES, where=room.y > tops)
    room.fill((left + 0.19, top, left + 0.21, bottom), _FRAME)
    room.fill((left, 0.3, right, 0.315), _FRAME)


def _books(room: _Room, left: float, bottom: float, chance: np.random.Generator) -> None:
    at = left + 0.02
    while at < left + 0.32:
        breadth, tall = 0.014 + 0.022 * chance.random(), 0.13 + 0.07 * chance.random()
        colour = _BOOKS[int(chance.integers(len(_BOOKS)))]
        room.fill((at, bottom - tall, at + breadth, bottom), colour, chance.uniform(0.8, 1.25))
        at += breadth + (0.06 if chance.random() < 0.06 else 0.002)
    room.fill((left, bottom, left + 0.36, bottom + 0.022), _BOARD)


def _sofa(room: _Room, left: float, chance: np.random.Generator) -> None:
    breadth = 0.62 * room.aspect
    room.fill((left, 0.68, left + breadth, 0.97), _SOFA, 1.05 - 0.25 * (room.y - 0.68))
    for arm in (left, left + breadth):
        room.fill((arm - 0.05, 0.75, arm + 0.05, 0.99), _SOFA, 0.87)
    cushion = left + 0.1 + 0.3 * room.aspect * chance.random()
    room.fill((cushion, 0.7, cushion + 0.2, 0.86), _CUSHION, 1.1 - 0.3 * (room.y - 0.7))
