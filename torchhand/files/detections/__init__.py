"""Keypoints that other programs detected."""

from torchhand.files.detections.formats import read_detections
from torchhand.files.detections.record import Detections, HandDetection, Units

__all__ = [
    "Detections",
    "HandDetection",
    "Units",
    "read_detections",
]
