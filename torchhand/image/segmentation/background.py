"""Telling the hand from a background known beforehand: an empty picture of it, or its key colour."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.image.operations import PicturePart


@dataclass(frozen=True, kw_only=True)
class BackgroundPlate:
    """The scene without a hand."""

    colour: UInt8[Tensor, "height width 3"]
    """Median picture of the empty scene."""
    noise: Float[Tensor, "height width 3"]
    """Standard deviation per pixel and channel, 8-bit levels."""

    def of_part(self, part: PicturePart) -> "BackgroundPlate":
        """The plate of a part of the picture, resampled."""
        return BackgroundPlate(colour=part.image(self.colour), noise=part.values(self.noise))


def learn_background(frames: UInt8[Tensor, "frames height width 3"], *, min_noise: float = 2.5) -> BackgroundPlate:
    """Plate from pictures of the empty scene: median, and noise from the median absolute deviation.

    `min_noise` (8-bit levels) bounds the noise from below; with one or two frames it is all there is.
    """
    if frames.shape[0] == 0:
        raise ValueError("learn_background needs at least one frame, got none")
    if len(frames) == 1:  # its own median; of a photograph, the median's indices would take a gigabyte
        noise = torch.full(frames.shape[1:], min_noise, dtype=torch.float32, device=frames.device)
        return BackgroundPlate(colour=frames[0], noise=noise)
    frames = frames.contiguous()  # the median of an expanded tensor is wrong (torch 2.13)
    colour = frames.median(dim=0).values
    deviation = (frames.to(torch.int16) - colour.to(torch.int16)).abs().median(dim=0).values
    noise = (1.4826 * deviation.to(torch.float32)).clamp_min(min_noise)
    return BackgroundPlate(colour=colour, noise=noise)


def background_mask(
    image: UInt8[Tensor, "height width 3"],
    plate: BackgroundPlate,
    *,
    threshold: float = 6.0,
    darkest_shadow: float = 0.5,
) -> Bool[Tensor, "height width"]:
    """Pixels that differ from the plate by over `threshold` standard deviations of its noise in some channel.

    A shadow is forgiven: a pixel that is the plate's colour times one factor in `darkest_shadow`..1, within the same
    threshold per channel, is background. 1 forgives none. A neutral hand darker than a neutral wall is a shadow too.
    """
    if image.shape != plate.colour.shape:
        sizes = f"{tuple(image.shape[:2])} and {tuple(plate.colour.shape[:2])}"
        raise ValueError(f"background_mask: picture and plate must have one size (height, width), got {sizes}")
    if not 0.0 < darkest_shadow <= 1.0:
        raise ValueError(f"background_mask: darkest_shadow must lie in (0, 1], got {darkest_shadow}")
    pixels, colour = image.cpu().contiguous().numpy(), plate.colour.cpu().contiguous().numpy()
    allowed = cv2.convertScaleAbs(plate.noise.cpu().contiguous().numpy(), alpha=threshold)
    exceeds = cv2.compare(cv2.absdiff(pixels, colour), allowed, cv2.CMP_GT)
    mask = cv2.transform(exceeds, np.ones((1, 3), np.float32)) > 0
    if darkest_shadow < 1.0:
        places = np.flatnonzero(mask)
        rows = [picture.reshape(-1, 3).take(places, axis=0).T for picture in (pixels, colour, allowed)]
        seen, plain, floor = (np.ascontiguousarray(row, dtype=np.float32) for row in rows)
        factor = np.einsum("ij,ij->j", seen, plain) / np.maximum(np.einsum("ij,ij->j", plain, plain), 1.0)
        within = np.abs(seen - factor * plain) <= floor
        is_shadow = (factor >= darkest_shadow) & (factor <= 1.0) & within[0] & within[1] & within[2]
        mask.reshape(-1)[places[is_shadow]] = False
    return torch.from_numpy(mask).to(image.device)


def chroma_mask(
    image: UInt8[Tensor, "height width 3"],
    key_hue_deg: float,
    *,
    tolerance_deg: float = 25.0,
    min_saturation: float = 0.3,
    min_value: float = 0.12,
) -> Bool[Tensor, "height width"]:
    """Pixels that are not the key colour of a coloured screen.

    Key is a hue within `tolerance_deg` of `key_hue_deg` (0 red, 120 green, 240 blue) whose saturation and value (0..1,
    HSV) reach the given minimum.
    """
    if not 0.0 <= key_hue_deg <= 360.0:
        raise ValueError(f"chroma_mask: key_hue_deg must lie in 0..360, got {key_hue_deg}")
    if not 0.0 < tolerance_deg < 180.0:
        raise ValueError(f"chroma_mask: tolerance_deg must lie between 0 and 180, got {tolerance_deg}")
    hsv = cv2.cvtColor(image.cpu().contiguous().numpy(), cv2.COLOR_RGB2HSV)
    floor = (255.0 * min_saturation, 255.0 * min_value)
    # Turns of the circle bring every stretch of hues near the key into 0..180, OpenCV's half degrees.
    is_key = np.zeros(hsv.shape[:2], np.uint8)
    for turn in (-360.0, 0.0, 360.0):
        low, high = (key_hue_deg + turn - tolerance_deg) / 2.0, (key_hue_deg + turn + tolerance_deg) / 2.0
        if high >= 0.0 and low < 180.0:
            lower, upper = np.ceil(np.array([max(low, 0.0), *floor])), np.array([np.floor(high), 255.0, 255.0])
            is_key = np.maximum(is_key, cv2.inRange(hsv, lower, upper))
    return torch.from_numpy(is_key == 0).to(image.device)
