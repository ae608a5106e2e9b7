"""Detectors of hand keypoints that run along with a tracker: MediaPipe, where it is installed."""

from torchhand.detect.detector import HandDetector
from torchhand.detect.hands import chosen_hand, hand_keypoints
from torchhand.detect.landmarks import Landmarker, Landmarks
from torchhand.detect.mediapipe import MediaPipe

__all__ = [
    "HandDetector",
    "Landmarker",
    "Landmarks",
    "MediaPipe",
    "chosen_hand",
    "hand_keypoints",
]
