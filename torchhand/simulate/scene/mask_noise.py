"""Masks as a segmentation gives them: with a boundary that is off by some pixels."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

_SMOOTH_PX = 1.5  # standard deviation of the blur that makes neighbouring errors alike


def noisy_mask(
    mask: Bool[Tensor, "height width"], std_px: float, generator: torch.Generator
) -> Bool[Tensor, "height width"]:
    """The mask with its boundary moved in or out by a Gaussian of that standard deviation.

    The error changes along the boundary within a few pixels, and tears no holes away from it. An empty mask stays so.
    """
    if not std_px >= 0:
        raise ValueError(f"std_px: expected 0 or more, got {std_px}")
    if std_px == 0:
        return mask.clone()
    white = torch.randn(mask.shape, generator=generator, dtype=torch.float32).numpy()
    if not bool(mask.any()):
        return mask.clone()
    error = cv2.GaussianBlur(white, (0, 0), _SMOOTH_PX, borderType=cv2.BORDER_REFLECT)
    error = error * (2 * np.sqrt(np.pi) * _SMOOTH_PX * std_px)  # a blur leaves 1 / (2 √π σ) of white noise
    inside = mask.numpy().astype(np.uint8)
    to_outside, to_inside = (
        cv2.distanceTransform(side, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for side in (inside, 1 - inside)
    )
    beyond = np.where(inside > 0, 0.5 - to_outside, to_inside - 0.5)
    return torch.from_numpy(beyond < error)
