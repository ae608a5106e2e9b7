"""Keypoints that other programs detected."""

from torchhand.files.detections.formats import read_detections
from torchhand.files.detections.record import Detections, Units

__all__ = [
    "Detections",
    "Units",
    "read_detections",
]
