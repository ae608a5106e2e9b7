"""Joint colour histograms of hand and surroundings, and the picture of how hand-like each pixel is."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.image.operations import suits_opencv
from torchhand.image.segmentation.histograms import log_ratio, look_up, probability_u8, smoothed

_LUMINANCE = (9798, 19235, 3735)  # of red, green and blue, 2⁻¹⁵: the fixed point numbers of OpenCV
_HALF_WEIGHT = 10.0  # pixels of a colour with which a picture counts as much as what was known before


@dataclass(frozen=True, kw_only=True)
class ColourModel:
    """Log of how much likelier a colour is inside than outside, both equally likely beforehand; brightness counts."""

    log_ratio: Float[Tensor, "red green blue"]
    """One value per bin; each axis divides 0..256 evenly."""

    @cached_property
    def table(self) -> Float[np.ndarray, "red green blue"]:
        """Probability of the inside per bin, times 255."""
        return probability_u8(self.log_ratio.cpu().numpy())


def learn_colours(
    image: UInt8[Tensor, "height width 3"],
    inside: Bool[Tensor, "height width"],
    outside: Bool[Tensor, "height width"],
    *,
    bins: int = 32,
    smoothing_bins: float = 1.0,
) -> ColourModel:
    """Colour model from two sets of pixels, which need not cover the picture: leave out what may be either.

    Smoothing and class weights as in `learn_skin`. Raises ValueError when a set is empty.
    """
    counts = _counts(image, inside, outside, (bins,) * 3, smoothing_bins)
    return ColourModel(log_ratio=torch.from_numpy(log_ratio(*counts).astype(np.float32)).to(image.device))


def relearn_colours(
    model: ColourModel,
    image: UInt8[Tensor, "height width 3"],
    inside: Bool[Tensor, "height width"],
    outside: Bool[Tensor, "height width"],
    *,
    keep: float,
    smoothing_bins: float = 1.0,
) -> ColourModel:
    """The model after another picture: `keep` of what was known of the colours in it, the rest from the picture.

    Log-likelihood ratios are averaged (a logarithmic opinion pool). A colour that the picture does not show is not
    forgotten: it counts by its pixels n as n / (n + 10). Raises ValueError when a set is empty.
    """
    counts = _counts(image, inside, outside, tuple(model.log_ratio.shape), smoothing_bins)
    pixels = counts[0] + counts[1]
    fraction = torch.from_numpy((1.0 - keep) * pixels / (pixels + _HALF_WEIGHT)).to(model.log_ratio)
    fresh = torch.from_numpy(log_ratio(*counts)).to(model.log_ratio)
    return ColourModel(log_ratio=torch.lerp(model.log_ratio, fresh, fraction))


def _counts(
    image: Tensor, inside: Tensor, outside: Tensor, bins: tuple[int, ...], smoothing_bins: float
) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed histograms of two sets of pixels."""
    pixels = image.cpu().contiguous().numpy()
    counts = []
    for name, mask in (("inside", inside), ("outside", outside)):
        if not bool(mask.any()):
            raise ValueError(f"a colour model needs at least one {name} pixel, got none")
        chosen = mask.to(torch.uint8).cpu().numpy()
        histogram = cv2.calcHist([pixels], [0, 1, 2], chosen, list(bins), [0, 256] * 3)
        counts.append(smoothed(histogram.astype(np.float64), smoothing_bins))
    return counts[0], counts[1]


def foreground_probability(image: UInt8[Tensor, "height width 3"], model: ColourModel) -> Float[Tensor, "height width"]:
    """Probability of the inside per pixel, 0..1, float32, rounded to 1/255: a picture to search edges in.

    In clutter its edges are the hand's where grey levels have edges everywhere. On a CPU OpenCV looks the colours up
    (1 ms at 640×480); `foreground_probability_torch` is its specification.
    """
    if not suits_opencv(image):
        return foreground_probability_torch(image, model)
    return torch.from_numpy(look_up(image.contiguous().numpy(), model.table, (256, 256, 256))) * (1.0 / 255.0)


def luminance(image: UInt8[Tensor, "height width 3"]) -> UInt8[Tensor, "height width"]:
    """0.299 red + 0.587 green + 0.114 blue, rounded."""
    if suits_opencv(image):
        return torch.from_numpy(cv2.cvtColor(image.contiguous().numpy(), cv2.COLOR_RGB2GRAY))
    fractions = torch.tensor(_LUMINANCE, device=image.device)
    return ((image.int() * fractions).sum(-1) + 2**14 >> 15).to(torch.uint8)


def foreground_probability_torch(
    image: UInt8[Tensor, "height width 3"], model: ColourModel
) -> Float[Tensor, "height width"]:
    """`foreground_probability` by an index of the table."""
    bins = torch.tensor(model.log_ratio.shape, device=image.device)
    red, green, blue = torch.div(image.to(torch.int64) * bins, 256, rounding_mode="floor").unbind(-1)
    ratio = model.log_ratio.to(image.device)[red, green, blue]
    return (torch.sigmoid(ratio.double()) * 255.0).round().float() * (1.0 / 255.0)
