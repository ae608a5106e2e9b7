"""The tracker: how a hand is found, followed through one camera or several, lost, found again and smoothed."""

from torchhand.track.knowledge import Estimate, Keyframe, TrackerState, restored_state, saved_state
from torchhand.track.scene import HandKeypoints, View
from torchhand.track.settings import DEFAULTS, TrackerSettings
from torchhand.track.smoothing import PastFrame, Smoother
from torchhand.track.tracker import Tracker

__all__ = [
    "DEFAULTS",
    "Estimate",
    "HandKeypoints",
    "Keyframe",
    "PastFrame",
    "Smoother",
    "Tracker",
    "TrackerSettings",
    "TrackerState",
    "View",
    "restored_state",
    "saved_state",
]
