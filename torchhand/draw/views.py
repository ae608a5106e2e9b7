"""What the tracker of several cameras saw, in one picture: every view with the model's contour over it."""

import math
from collections.abc import Collection, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.draw.overlay import STATUS_COLOURS, draw_contour, write_line
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.view import HandProjector

_WIDEST = 1280  # px of the whole picture
_DARK = (40, 40, 44)
_WORDS = (235, 235, 235)


class ViewsOverlay:
    """Draws the views of a rig side by side, reduced to fit."""

    def __init__(self, kinematics: HandKinematics, cameras: Sequence[Camera], shape: Float[Tensor, "shape"]) -> None:
        """cameras: as they took the pictures, with their distortion."""
        self.columns = math.ceil(math.sqrt(len(cameras)))
        self.rows = math.ceil(len(cameras) / self.columns)
        widest, highest = max(c.width for c in cameras), max(c.height for c in cameras)
        scale = min(1.0, _WIDEST / (self.columns * widest))
        self._cameras = [camera.resized(scale) for camera in cameras]
        self._projectors = [HandProjector(kinematics, camera, shape) for camera in self._cameras]
        self._tile = (max(1, round(widest * scale)), max(1, round(highest * scale)))
        width, height = self.size
        self._empty = np.full((height, width, 3), _DARK, dtype=np.uint8)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px; both even, as video codecs want them."""
        width, height = self.columns * self._tile[0], self.rows * self._tile[1]
        return width + width % 2, height + height % 2

    def __call__(
        self,
        images: Sequence[UInt8[Tensor, "_height _width 3"] | None],
        pose: Float[Tensor, "36"] | None,
        *,
        status: str,
        frame: int,
        overlaps: Sequence[float] | None = None,
        problems: Sequence[str | None] | None = None,
        undetermined: Collection[str] = (),
    ) -> UInt8[Tensor, "overlay_height overlay_width 3"]:
        """One frame, RGB, of `size`.

        pose: with the root's whole rotation vector, world frame; None where the hand is lost. overlaps: of every view,
        NaN where unknown. problems: why a view has no picture. undetermined: names of FINGERS that are drawn dashed.

        Raises ValueError for a status that is not one of STATUS_COLOURS.
        """
        if status not in STATUS_COLOURS:
            raise ValueError(f"status: expected one of {', '.join(STATUS_COLOURS)}, got {status!r}")
        canvas = self._empty.copy()
        identity = torch.eye(3, dtype=torch.float64)
        for view, (camera, projector) in enumerate(zip(self._cameras, self._projectors, strict=True)):
            left, top = view % self.columns * self._tile[0], view // self.columns * self._tile[1]
            tile = canvas[top : top + camera.height, left : left + camera.width]
            image = images[view]
            if image is None:
                _write(tile, (problems[view] if problems else None) or "no picture")
            else:
                tile[:] = cv2.resize(image.cpu().numpy(), (camera.width, camera.height), interpolation=cv2.INTER_AREA)
            if pose is not None:
                draw_contour(tile, projector, pose, identity, undetermined)
            overlap = math.nan if overlaps is None else overlaps[view]
            write_line(tile, frame, status, overlap if math.isfinite(overlap) else None)
            _write(tile, camera.name, low=True)
        return torch.from_numpy(canvas)


def _write(tile: np.ndarray, words: str, *, low: bool = False) -> None:
    """Words in the tile's middle, or at its lower left."""
    height, width = tile.shape[:2]
    scale = max(0.35, height / 900)
    font = cv2.FONT_HERSHEY_SIMPLEX
    length = cv2.getTextSize(words, font, scale, 1)[0][0]
    place = (8, height - 8) if low else (max(4, (width - length) // 2), height // 2)
    cv2.putText(tile, words, place, font, scale, _WORDS, 1, cv2.LINE_AA)
