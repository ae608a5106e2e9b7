"""What runs read: recordings of one camera or several, and cameras that are watched while they take pictures."""

from torchhand.runs.recordings.live import LiveCamera, LiveRecording
from torchhand.runs.recordings.recording import (
    ASSUMED_CAMERA,
    OneCameraRecording,
    RecordedFrame,
    Recording,
    RigRecording,
    first_open_hand,
    reversed_frames,
    rig_plates,
)
from torchhand.runs.recordings.shares import Share, shares_of

__all__ = [
    "ASSUMED_CAMERA",
    "LiveCamera",
    "LiveRecording",
    "OneCameraRecording",
    "RecordedFrame",
    "Recording",
    "RigRecording",
    "Share",
    "first_open_hand",
    "reversed_frames",
    "rig_plates",
    "shares_of",
]
