"""Square crops of pictures about hands, and the cameras of their pixels."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.propose import SIDE_PX

SHARE = 0.75
"""Larger side of the box about the points over that of a crop."""
Window = tuple[int, int, int]
"""Left and upper edge, and side, of a square, px."""


def window_about(points_px: Float[Tensor, "points 2"], *, share: float = SHARE, shift: Tensor | None = None) -> Window:
    """The square about the box of some points. share: as SHARE. shift: of its middle, over its side."""
    low, high = points_px.amin(0), points_px.amax(0)
    side = max(4.0, float((high - low).amax()) / share)
    middle = 0.5 * (low + high) + 0.5
    x, y = (middle if shift is None else middle + side * shift).tolist()
    whole = round(side)
    return round(x - 0.5 * whole), round(y - 0.5 * whole), whole


def cut(image: UInt8[np.ndarray, "..."], window: Window, side_px: int = SIDE_PX) -> UInt8[np.ndarray, "..."]:
    """The window's pixels, averaged; beyond the picture's edge its outermost ones go on."""
    x, y, side = window
    height, width = image.shape[:2]
    above, below, before, after = max(0, -y), max(0, y + side - height), max(0, -x), max(0, x + side - width)
    if above or below or before or after:
        image = cv2.copyMakeBorder(image, above, below, before, after, cv2.BORDER_REPLICATE)
    top, left = y + above, x + before
    return cv2.resize(image[top : top + side, left : left + side], (side_px, side_px), interpolation=cv2.INTER_AREA)


def moved_points(points_px: Float[Tensor, "*n 2"], window: Window, side_px: int = SIDE_PX) -> Float[Tensor, "*n 2"]:
    """Where points of the picture are in the crop."""
    x, y, side = window
    return (points_px - points_px.new_tensor((x, y)) + 0.5) * (side_px / side) - 0.5


def moved_intrinsics(intrinsics: Float[Tensor, "3 3"], window: Window, side_px: int = SIDE_PX) -> Float[Tensor, "3 3"]:
    """The camera of the crop's pixels."""
    scale, moved = side_px / window[2], intrinsics.clone()
    moved[:2, :2] *= scale
    moved[:2, 2] = moved_points(intrinsics[:2, 2], window, side_px)
    return moved


def mirrored_intrinsics(intrinsics: Float[Tensor, "3 3"], width_px: int) -> Float[Tensor, "3 3"]:
    """The camera of the mirror image."""
    moved = intrinsics.clone()
    moved[0, 2] = width_px - 1 - intrinsics[0, 2]
    return moved
