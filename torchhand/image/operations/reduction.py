"""Pictures made smaller by the mean over the area that each new pixel covers, and masks made larger again."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.devices import kept
from torchhand.image.operations.backends import suits_opencv

_HALF = 0.499  # of a pixel's area, less what rounding may take away


def reduced(
    plane: Float[Tensor, "height width"], height: int, width: int
) -> Float[Tensor, "reduced_height reduced_width"]:
    """The plane at a size of at most its own; each new pixel has the mean over what it covers."""
    _check(plane, height, width)
    if suits_opencv(plane):
        pixels = cv2.resize(plane.detach().contiguous().numpy(), (width, height), interpolation=cv2.INTER_AREA)
        return torch.from_numpy(pixels)
    rows, columns = (_fractions(*sizes).to(plane) for sizes in ((plane.shape[0], height), (plane.shape[1], width)))
    return rows @ plane @ columns.mT


def reduced_mask(
    mask: Bool[Tensor, "height width"], height: int, width: int
) -> Bool[Tensor, "reduced_height reduced_width"]:
    """The mask at a size of at most its own; a new pixel is set where half of what it covers is, or more."""
    _check(mask, height, width)
    if suits_opencv(mask):
        pixels = mask.contiguous().view(torch.uint8).numpy() * np.uint8(255)
        return torch.from_numpy(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA) > 127)
    return reduced(mask.float(), height, width) > _HALF


def enlarged_mask(
    mask: Bool[Tensor, "height width"], height: int, width: int
) -> Bool[Tensor, "enlarged_height enlarged_width"]:
    """The mask at another size, such as that of the picture before it was reduced; a new pixel is set where, between
    the old ones, it would be by more than half."""
    if suits_opencv(mask):
        plane = cv2.resize(mask.numpy().astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
        return torch.from_numpy(plane > 0.5)
    return torch.nn.functional.interpolate(mask[None, None].float(), (height, width), mode="bilinear")[0, 0] > 0.5


def _check(plane: Tensor, height: int, width: int) -> None:
    if not (1 <= height <= plane.shape[0] and 1 <= width <= plane.shape[1]):
        raise ValueError(f"size: expected 1 to {tuple(plane.shape)}, got {(height, width)}")


@kept(64)
def _fractions(size: int, reduced_size: int) -> Float[Tensor, "reduced_size size"]:
    """Share of each old pixel in each new one, along one dimension; float64."""
    edges = torch.arange(reduced_size + 1, dtype=torch.float64) * (size / reduced_size)
    places = torch.arange(size, dtype=torch.float64)
    ends = torch.minimum(edges[1:, None], places + 1), torch.maximum(edges[:-1, None], places)
    return (ends[0] - ends[1]).clamp_min(0.0) * (reduced_size / size)
