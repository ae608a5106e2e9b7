"""The frames of a recording together: how a hand moves, and poses smoothed over time."""

from torchhand.fit.keypoints.recording.motion import Motion, motion_of
from torchhand.fit.keypoints.recording.path import PosePath, Smoothed, is_short_gap

__all__ = ["Motion", "PosePath", "Smoothed", "is_short_gap", "motion_of"]
