"""What skin looks like in this video: a histogram of hue and saturation, and the probability it gives to a pixel."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.image.segmentation.histograms import log_ratio, look_up, probability_u8, smoothed

HUE_SATURATION_ENDS = (180, 256)
"""OpenCV's 8-bit hue counts half degrees; saturation goes to 255."""


@dataclass(frozen=True, kw_only=True)
class SkinModel:
    """Log of how much likelier a colour is on skin than elsewhere, with both equally likely beforehand."""

    log_ratio: Float[Tensor, "hue saturation"]
    """One value per bin; hue bins divide 0..180 (half degrees), saturation bins 0..256."""
    dark_log_ratio: float
    """Log-likelihood ratio of pixels too dark for hue to mean anything, counted together."""
    dark_value: int
    """A pixel whose largest channel is below this is dark; 0..255."""


def learn_skin(
    image: UInt8[Tensor, "height width 3"],
    mask: Bool[Tensor, "height width"],
    ignore: Bool[Tensor, "height width"] | None = None,
    *,
    bins: int = 32,
    dark_value: int | None = None,
    smoothing_bins: float = 0.8,
) -> SkinModel:
    """Skin model from the pixels of `mask` against all others, `ignore` (say, a band along the outline) left out.

    `dark_value` left out is taken from the picture: 0.6 of what all but the darkest 5 % of the skin pixels exceed,
    within 16..100, which also rejects the rim of skin hue that coarse colour coding leaves on a dark background.
    Counts are smoothed by a Gaussian of `smoothing_bins` (hue wraps around) and a bit of one 4 times wider, brought to
    equal class weight, and mixed with a uniform share, larger for the background, so that a colour never seen is
    background.
    Raises ValueError when a class has no pixel.
    """
    used = torch.ones_like(mask) if ignore is None else ~ignore
    skin, rest = (mask & used).cpu().numpy(), (~mask & used).cpu().numpy()
    for name, pixels in (("skin", skin), ("background", rest)):
        if not pixels.any():
            raise ValueError(f"learn_skin needs at least one {name} pixel, got none")
    hsv = _hsv(image)
    if dark_value is None:
        dark_value = int(np.clip(0.6 * np.percentile(hsv[..., 2][skin], 5), 16, 100))
    cells = log_ratio(
        _cell_counts(hsv, skin, bins, dark_value, smoothing_bins),
        _cell_counts(hsv, rest, bins, dark_value, smoothing_bins),
    )
    table = torch.from_numpy(cells[:-1].reshape(bins, bins).astype(np.float32)).to(image.device)
    return SkinModel(log_ratio=table, dark_log_ratio=float(cells[-1]), dark_value=dark_value)


def skin_probability(image: UInt8[Tensor, "height width 3"], model: SkinModel) -> Float[Tensor, "height width"]:
    """Probability of skin per pixel, 0..1, float32, rounded to 1/255.

    On a CPU OpenCV looks the colours up (1.5 ms at 640×480); `skin_probability_torch` is its specification.
    """
    if image.device.type != "cpu":
        return skin_probability_torch(image, model)
    return torch.from_numpy(skin_probability_u8(image, model)) * (1.0 / 255.0)


def skin_probability_u8(image: UInt8[Tensor, "height width 3"], model: SkinModel) -> np.ndarray:
    """`skin_probability` times 255 as an 8-bit array."""
    found, value = hue_probability_u8(image, model)
    return with_dark_u8(found, value, model)


def hue_probability_u8(image: UInt8[Tensor, "height width 3"], model: SkinModel) -> tuple[np.ndarray, np.ndarray]:
    """The probability by hue and saturation alone, 8 bit, however dark a pixel is, and every pixel's largest channel;
    what per-frame work on a CPU goes on with."""
    hsv = _hsv(image)
    found = look_up(hsv, probability_u8(model.log_ratio.cpu().numpy()), HUE_SATURATION_ENDS)
    return found, cv2.extractChannel(hsv, 2)


def with_dark_u8(found: np.ndarray, value: np.ndarray, model: SkinModel) -> np.ndarray:
    """What `hue_probability_u8` gives, with the model's one probability where a pixel is dark."""
    dark = probability_u8(np.array([model.dark_log_ratio])).astype(np.uint8)[0]
    return np.where(value < model.dark_value, dark, found)


def skin_probability_torch(image: UInt8[Tensor, "height width 3"], model: SkinModel) -> Float[Tensor, "height width"]:
    """`skin_probability` by an index of the table; only the conversion to hue is OpenCV's."""
    hsv = torch.from_numpy(_hsv(image)).to(image.device, torch.int64)
    hues, saturations = model.log_ratio.shape
    hue_end, saturation_end = HUE_SATURATION_ENDS
    hue = torch.div(hsv[..., 0] * hues, hue_end, rounding_mode="floor")
    saturation = torch.div(hsv[..., 1] * saturations, saturation_end, rounding_mode="floor")
    ratio = model.log_ratio.to(image.device)[hue, saturation]
    ratio = torch.where(hsv[..., 2] < model.dark_value, model.dark_log_ratio, ratio)
    return (torch.sigmoid(ratio.double()) * 255.0).round().float() * (1.0 / 255.0)


def _hsv(image: Tensor) -> np.ndarray:
    return cv2.cvtColor(image.cpu().contiguous().numpy(), cv2.COLOR_RGB2HSV)


def _cell_counts(hsv: np.ndarray, pixels: np.ndarray, bins: int, dark_value: int, smoothing_bins: float) -> np.ndarray:
    """Smoothed counts of the bright pixels' (hue, saturation) bins in one row; the dark pixels are the last cell."""
    is_dark = hsv[..., 2] < dark_value
    bright = (pixels & ~is_dark).astype(np.uint8)
    hue_end, saturation_end = HUE_SATURATION_ENDS
    counts = cv2.calcHist([hsv], [0, 1], bright, [bins, bins], [0, hue_end, 0, saturation_end]).astype(np.float64)
    return np.append(smoothed(counts, smoothing_bins, wrapped_axes=(0,)), float((pixels & is_dark).sum()))
