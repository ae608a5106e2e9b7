"""How far a detector's keypoints are from the truth, point by point and angle by angle."""

from torchhand.study.detector.errors import DetectorErrors, detector_errors
from torchhand.study.detector.recordings import DetectedRecording, read_recordings
from torchhand.study.detector.table import error_table

__all__ = [
    "DetectedRecording",
    "DetectorErrors",
    "detector_errors",
    "error_table",
    "read_recordings",
]
