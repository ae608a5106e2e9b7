"""Keypoints that other programs detected."""

from torchhand.files.detections.formats import read_detections
from torchhand.files.detections.record import DetectedHand, Detections, Units

__all__ = [
    "DetectedHand",
    "Detections",
    "Units",
    "read_detections",
]
