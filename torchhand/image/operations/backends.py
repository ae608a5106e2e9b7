"""Where OpenCV computes and where torch does: the one rule that every operation on pictures here asks."""

import torch
from torch import Tensor


def suits_opencv(*pictures: Tensor) -> bool:
    """Whether all pictures lie in the CPU's memory and carry no gradient, so that OpenCV may read them.

    OpenCV is several times faster there. Everything else is computed by torch and kornia, to the same result.
    """
    needs_gradient = torch.is_grad_enabled() and any(picture.requires_grad for picture in pictures)
    return not needs_gradient and all(picture.device.type == "cpu" for picture in pictures)
