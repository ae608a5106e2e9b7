"""Operations on pictures and masks: OpenCV on a CPU, kornia and torch elsewhere, to the same result."""

from torchhand.image.operations.backends import suits_opencv
from torchhand.image.operations.morphology import (
    binomial_blur,
    bounding_box,
    closed,
    count_pieces,
    dilate,
    disc_kernel,
    erode,
    gaussian_blur,
    gradient,
    label_pieces,
    numbered_pieces,
    opened,
    square_kernel,
)
from torchhand.image.operations.overlaps import hand_region, intersection_over_union
from torchhand.image.operations.parts import WORKING_PIXELS, PicturePart
from torchhand.image.operations.reduction import enlarged_mask, reduced, reduced_mask

__all__ = [
    "WORKING_PIXELS",
    "PicturePart",
    "binomial_blur",
    "bounding_box",
    "closed",
    "count_pieces",
    "dilate",
    "disc_kernel",
    "enlarged_mask",
    "erode",
    "gaussian_blur",
    "gradient",
    "hand_region",
    "intersection_over_union",
    "label_pieces",
    "numbered_pieces",
    "opened",
    "reduced",
    "reduced_mask",
    "square_kernel",
    "suits_opencv",
]
