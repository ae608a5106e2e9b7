"""Keypoints that other programs detected."""

from torchhand.files.detections.detection_log import KEYPOINTS_NAME, DetectionLog, save_detections
from torchhand.files.detections.formats import read_detections, read_rig_detections
from torchhand.files.detections.record import Detections, HandDetection, Units

__all__ = [
    "KEYPOINTS_NAME",
    "DetectionLog",
    "Detections",
    "HandDetection",
    "Units",
    "read_detections",
    "read_rig_detections",
    "save_detections",
]
