"""The light of a picture against that of an earlier one of the same scene, and pictures as that would show them."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.image.operations import suits_opencv

_GRID = (24, 32)  # rows and columns of pixels that are compared
_RANGE = (12, 250)  # values that are neither mostly noise nor saturated
_FEWEST = 0.3  # share of the compared pixels that have such values, at least
_SAME = 0.04  # log of a gain up to which the light is the same
_SPREAD, _NOISE = 0.08, 2.0
"""Distance of a pixel's log ratio from the median up to which it bears that out, and what the noise of its value adds,
as a value: half of the pixels do where the light is another. Where the camera turns, or something near covers the
picture, fewer do."""


@dataclass(frozen=True, kw_only=True)
class Light:
    """A scene in the light of one picture; exposure and white balance of the camera count as light."""

    sample: UInt8[Tensor, "rows columns 3"]
    """Pixels of that picture on a grid over it."""
    gains: Float[Tensor, "3"]
    """How many times brighter the channels are in it than in the light that is meant."""

    @classmethod
    def of(cls, image: UInt8[Tensor, "height width 3"]) -> "Light":
        """The light of a picture, which is the one that is meant."""
        return cls(sample=_sample(image), gains=torch.ones(3))

    def later(self, image: UInt8[Tensor, "height width 3"]) -> "Light":
        """The light of a later picture of the scene, against the same one."""
        return Light(sample=_sample(image), gains=self.gains_of(image))

    def gains_of(self, image: UInt8[Tensor, "height width 3"]) -> Float[Tensor, "3"]:
        """How many times brighter a picture of the scene is than in the light that is meant, channel by channel.

        As in the own picture where that is seen in the same light, or where not most of what both show differs by the
        same factor: then something else has changed.
        """
        pixels = torch.stack((self.sample, _sample(image))).flatten(1, 2)
        known = pixels[:, ((pixels >= _RANGE[0]) & (pixels <= _RANGE[1])).all(-1).all(0)].double()
        if known.shape[1] < _FEWEST * pixels.shape[1]:
            return self.gains
        ratios = (known[1] / known[0]).log()
        ratio = ratios.median(0).values
        spread = ((ratios - ratio).abs() / (_SPREAD + _NOISE / known.amin(0))).median(0).values
        if bool((ratio.abs() < _SAME).all()) or bool((spread > 1).any()):
            return self.gains
        return self.gains * ratio.exp().to(self.gains)

    def undone(self, image: UInt8[Tensor, "height width 3"]) -> UInt8[Tensor, "height width 3"]:
        """A picture of the scene as it would be in the light that is meant; itself where it is so."""
        gains = self.gains_of(image)
        if bool((gains == 1).all()):
            return image
        table = (torch.arange(256)[:, None] / gains.cpu()).round().clamp(max=255).to(torch.uint8)
        if suits_opencv(image):
            return torch.from_numpy(cv2.LUT(image.contiguous().numpy(), np.ascontiguousarray(table.numpy()[None])))
        table = table.to(image.device)
        return torch.stack([table[image[..., channel].long(), channel] for channel in range(3)], -1)


def _sample(image: Tensor) -> UInt8[Tensor, "rows columns 3"]:
    """Pixels on a grid over a picture, which lie at the same places of it whatever its size."""
    rows, columns = (
        ((torch.arange(count, device=image.device) + 0.5) * (size / count)).long()
        for count, size in zip(_GRID, image.shape[:2], strict=True)
    )
    return image[rows[:, None], columns]
