"""The fingers of an open hand in a mask: their order, profiles, regions and the refinement of its silhouette."""

from torchhand.image.fingers.fingers import FingerSettings, find_fingers
from torchhand.image.fingers.moments import MaskMoments, mask_moments
from torchhand.image.fingers.order import DIGITS
from torchhand.image.fingers.refinement import (
    HandSilhouette,
    RefinementSettings,
    find_open_hand,
    fingers_apart,
    refine_silhouette,
)
from torchhand.image.fingers.regions import HandRegions, NoRegions, divide_hand

__all__ = [
    "DIGITS",
    "FingerSettings",
    "HandRegions",
    "HandSilhouette",
    "MaskMoments",
    "NoRegions",
    "RefinementSettings",
    "divide_hand",
    "find_fingers",
    "find_open_hand",
    "fingers_apart",
    "mask_moments",
    "refine_silhouette",
]
