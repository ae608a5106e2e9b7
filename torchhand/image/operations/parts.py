"""Parts of a picture, at a size that bounds the work."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

WORKING_PIXELS = 2_100_000
"""To which larger pictures are reduced, a little over full HD: an outline says no more of a hand in a larger one."""


@dataclass(frozen=True, kw_only=True)
class PicturePart:
    """A rectangle of a picture, resampled; (x, y), px."""

    corner: tuple[int, int]
    """First pixel of the rectangle in the whole picture."""
    part: tuple[int, int]
    """Width and height of the rectangle in the whole picture."""
    size: tuple[int, int]
    """Width and height after resampling."""

    @classmethod
    def of(
        cls, corner: tuple[int, int], part: tuple[int, int], max_pixels: int, *, scale: float = 1.0
    ) -> "PicturePart":
        """The rectangle with sides so many times as long, or as long as at most so many pixels allow."""
        scale = min(scale, math.sqrt(max_pixels / (part[0] * part[1])))
        return cls(corner=corner, part=part, size=(max(1, round(part[0] * scale)), max(1, round(part[1] * scale))))

    @classmethod
    def about(cls, mask: Bool[Tensor, "height width"], within: "PicturePart", max_pixels: int) -> "PicturePart":
        """The rectangle about what is set in another part's mask, with a margin of a part of its sides."""
        height, width = within.part[1] + within.corner[1], within.part[0] + within.corner[0]
        corner, end = [], []
        for axis, (limit, counts) in enumerate(((width, mask.any(0)), (height, mask.any(1)))):
            places = torch.nonzero(counts)[:, 0]
            low, high = float(places[0]), float(places[-1] + 1)
            margin = _MARGIN * (high - low) + 1
            scale = within.part[axis] / within.size[axis]
            corner.append(max(0, math.floor(within.corner[axis] + (low - margin) * scale)))
            end.append(min(limit, math.ceil(within.corner[axis] + (high + margin) * scale)))
        return cls.of((corner[0], corner[1]), (end[0] - corner[0], end[1] - corner[1]), max_pixels)

    @property
    def scale(self) -> float:
        """Pixels of the part to one of the whole picture, along a side."""
        return math.sqrt(self.size[0] * self.size[1] / (self.part[0] * self.part[1]))

    def image(self, whole: UInt8[Tensor, "height width 3"]) -> UInt8[Tensor, "part_height part_width 3"]:
        """The part of a picture."""
        return torch.from_numpy(self._resampled(whole.cpu().numpy()))

    def values(self, whole: Float[Tensor, "height width 3"]) -> Float[Tensor, "part_height part_width 3"]:
        """The part of an array of numbers."""
        return torch.from_numpy(self._resampled(whole.cpu().numpy()))

    def mask(self, whole: Bool[Tensor, "height width"]) -> Bool[Tensor, "part_height part_width"]:
        """The part of a silhouette."""
        return torch.from_numpy(self._resampled(whole.cpu().numpy().astype(np.uint8) * np.uint8(255)) > 127)

    def whole_px(self, points_px: np.ndarray) -> np.ndarray:
        """Points (..., 2) of the part in the whole picture."""
        scale = np.divide(self.part, self.size)
        return (np.asarray(points_px, np.float64) + 0.5) * scale - 0.5 + np.asarray(self.corner)

    def part_px(self, points_px: np.ndarray) -> np.ndarray:
        """Points (..., 2) of the whole picture in the part."""
        scale = np.divide(self.size, self.part)
        return (np.asarray(points_px, np.float64) - np.asarray(self.corner) + 0.5) * scale - 0.5

    def _resampled(self, whole: np.ndarray) -> np.ndarray:
        (x, y), (width, height) = self.corner, self.part
        cut = np.ascontiguousarray(whole[y : y + height, x : x + width])
        if self.size == self.part:
            return cut
        return cv2.resize(cut, self.size, interpolation=cv2.INTER_AREA if self.scale < 1 else cv2.INTER_CUBIC)


_MARGIN = 0.15
