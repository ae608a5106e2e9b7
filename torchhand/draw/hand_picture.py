"""Pictures of a hand's skin alone: shaded, on plain paper, with a line of text; only the hand's window is drawn."""

import math
from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import Hand, PosedMesh, posed_mesh
from torchhand.view import cast, shade

PAPER = (246, 246, 244)
SKIN = (0.86, 0.66, 0.55)
_INK, _FAINT, _TRACE = (40, 44, 52), (176, 178, 182), (38, 98, 190)
_LIGHT, _AMBIENT = (-0.35, -0.6, -0.72), 0.4
_FONT = cv2.FONT_HERSHEY_SIMPLEX


class HandPainter:
    """Draws one hand before one camera."""

    def __init__(self, hand: Hand, camera: Camera, *, paper: tuple[int, int, int] = PAPER, smoothing: int = 1) -> None:
        """camera: without distortion. smoothing: rays per pixel along each axis."""
        self._hand, self._smoothing = hand, smoothing
        self._camera = camera.to(dtype=hand.shape.dtype)
        self._paper = np.full((camera.height, camera.width, 3), paper, dtype=np.uint8)

    def surfaces(self, poses: Float[Tensor, "frames 36"]) -> PosedMesh:
        """The skins of some poses, camera or world frame as the camera has it."""
        with torch.inference_mode():
            return posed_mesh(self._hand, self._hand(poses.to(self._hand.shape.dtype)))

    def paint(self, surface: PosedMesh) -> UInt8[Tensor, "height width 3"]:
        """One picture of one surface, RGB."""
        picture = self._paper.copy()
        with torch.inference_mode():
            points = self._camera.cam_from_world(surface.vertices)
            if bool((points[:, 2] <= 1e-3).any()):
                left, top, right, bottom = 0, 0, self._camera.width, self._camera.height
            else:
                pixels = self._camera.project(surface.vertices)
                (left, top), (right, bottom) = ([math.floor(float(x)) for x in ends] for ends in pixels.aminmax(dim=0))
                left, top = max(0, left - 1), max(0, top - 1)
                right, bottom = min(self._camera.width, right + 3), min(self._camera.height, bottom + 3)
            if right <= left or bottom <= top:
                return torch.from_numpy(picture)
            intrinsics = self._camera.intrinsics.clone()
            intrinsics[:2, 2] -= intrinsics.new_tensor((left, top))
            window = replace(self._camera, intrinsics=intrinsics, width=right - left, height=bottom - top)
            behind = torch.from_numpy(picture[top:bottom, left:right])
            side = self._smoothing
            if side > 1:
                window = window.resized(float(side))
                behind = behind.repeat_interleave(side, 0).repeat_interleave(side, 1)
            drawn = shade(cast(surface, window), skin=SKIN, background=behind, light=_LIGHT, ambient=_AMBIENT).numpy()
        if side > 1:
            drawn = cv2.resize(drawn, (right - left, bottom - top), interpolation=cv2.INTER_AREA)
        picture[top:bottom, left:right] = drawn
        return torch.from_numpy(picture)


def write_word(picture: UInt8[Tensor, "height width 3"], word: str, at: int) -> None:
    """Write a word below the hand into the picture, the letter at one place darker than the others."""
    height, width = picture.shape[:2]
    size = height / 480
    sizes = [cv2.getTextSize(letter, _FONT, 1.1 * size, 1)[0][0] + round(3 * size) for letter in word]
    if sum(sizes) > 0.95 * width:  # a long text: some letters around the present one
        around = range(max(0, at - 4), min(len(word), at + 5))
        word, sizes, at = "".join(word[i] for i in around), [sizes[i] for i in around], at - around.start
    x = (width - sum(sizes)) // 2
    for i, (letter, step) in enumerate(zip(word, sizes, strict=True)):
        colour = _INK if i == at else _FAINT
        place = (x, height - round(16 * size))
        cv2.putText(picture.numpy(), letter, place, _FONT, 1.1 * size, colour, max(1, round(2 * size)), cv2.LINE_AA)
        x += step


def write_sign(picture: UInt8[Tensor, "height width 3"], sign: str) -> None:
    """Write a sign's name into the upper left corner of its picture."""
    size = picture.shape[0] / 128
    place = (round(7 * size), round(22 * size))
    cv2.putText(picture.numpy(), sign, place, _FONT, 0.62 * size, _INK, max(1, round(size)), cv2.LINE_AA)


def draw_trace(picture: UInt8[Tensor, "height width 3"], points_px: Float[Tensor, "points 2"]) -> None:
    """Draw the way of a fingertip as a line with an arrow's head."""
    size = picture.shape[0] / 128
    line = np.rint(points_px.double().numpy() * 16).astype(np.int32).reshape(-1, 1, 2)
    canvas = picture.numpy()
    cv2.polylines(canvas, [line], False, _TRACE, max(1, round(1.2 * size)), cv2.LINE_AA, 4)
    end, before = points_px[-1].double().numpy(), points_px[-6].double().numpy()
    along = (end - before) / max(1e-9, float(np.linalg.norm(end - before)))
    side = np.array((-along[1], along[0]))
    head = [end + 4 * size * along, end - 3 * size * along + 3 * size * side, end - 3 * size * along - 3 * size * side]
    cv2.fillPoly(canvas, [np.rint(np.array(head) * 16).astype(np.int32)], _TRACE, cv2.LINE_AA, 4)
