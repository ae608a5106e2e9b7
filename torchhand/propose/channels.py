"""What the network sees of a view: the silhouette, the relief inside it, and what lies outside the picture."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import kept

CHANNELS = 3
_SIGMA_PX = 5.0  # neighbourhood in which grey levels are compared
_LEAST_CONTRAST = 0.01  # of grey levels 0..1: less is noise of the sensor
_SHARE = 0.3  # of the contrast of the whole hand that every neighbourhood is taken to have at least
_STEEPEST = 3.0


def network_channels(
    mask: Float[Tensor, "n side side"],
    grey: Float[Tensor, "n side side"],
    known: Float[Tensor, "n side side"],
) -> Float[Tensor, "n channels side side"]:
    """Silhouette as −1 and 1, normalised grey levels inside it, and where nothing is known, 0 and 1.

    mask: share of each pixel that is hand, 0 to 1. grey: levels 0 to 1; a constant where they are not known. known:
    share of each pixel inside the picture.
    """
    inside = mask * known
    return torch.stack((2 * inside - 1, normalized_grey(inside, grey), 1 - known), 1)


def normalized_grey(
    mask: Float[Tensor, "n side side"], grey: Float[Tensor, "n side side"]
) -> Float[Tensor, "n side side"]:
    """Grey levels less the mean of their neighbours in the mask, over the standard deviation of these; about -3 to 3.

    So neither the light nor the colour of the skin matters, only creases, edges and shading.
    """
    weight = mask.clamp_min(0)
    total = weight.sum((1, 2), keepdim=True).clamp_min(1)
    mean = (weight * grey).sum((1, 2), keepdim=True) / total
    centred = (grey - mean) * (weight > 0.5)
    contrast = (weight * centred.square()).sum((1, 2), keepdim=True).div(total).sqrt()
    blurred = gaussian_blur_of(torch.stack((weight, weight * centred, weight * centred.square()), 1), _SIGMA_PX)
    near = blurred[:, 0].clamp_min(1e-3)
    local = blurred[:, 1] / near
    spread = (blurred[:, 2] / near - local.square()).clamp_min(0).sqrt()
    scaled = (centred - local) / (spread + _SHARE * contrast + _LEAST_CONTRAST)
    return scaled.clamp(-_STEEPEST, _STEEPEST) * (weight > 0.5)


def gaussian_blur_of(pictures: Float[Tensor, "n c side side"], sigma_px: float) -> Float[Tensor, "n c side side"]:
    """Pictures blurred, with nothing but zeros around them."""
    band = _blur_band(pictures.shape[-1], sigma_px, pictures.dtype, pictures.device)
    return band @ pictures @ band.T


@kept(16)
def _blur_band(side: int, sigma_px: float, dtype: torch.dtype, device: torch.device) -> Float[Tensor, "side side"]:
    """The blur along one axis as a matrix."""
    reach = max(1, round(2.5 * sigma_px))
    steps = torch.arange(-reach, reach + 1, dtype=dtype, device=device)
    kernel = torch.exp(-0.5 * (steps / sigma_px).square())
    kernel = kernel / kernel.sum()
    rows = torch.arange(side, device=device)
    offset = rows[:, None] - rows + reach
    return torch.where((offset >= 0) & (offset <= 2 * reach), kernel[offset.clamp(0, 2 * reach)], 0.0)
