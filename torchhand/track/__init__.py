"""Trackers: how a hand is followed through a video, lost and found again."""

from torchhand.track.estimate import posed_belief
from torchhand.track.measured import Measured, SeenContour
from torchhand.track.prior import Kind, PosturePrior, kind_of, posture_prior
from torchhand.track.rebasing import Rebasing
from torchhand.track.settings import (
    ContourTrackerSettings,
    LightSettings,
    LossSettings,
    NoiseSettings,
    TrackerSettings,
    require,
    require_positive,
)
from torchhand.track.state import Estimate, Memory, Status, TrackerState
from torchhand.track.tracker import HandTracker, start_spread

__all__ = [
    "ContourTrackerSettings",
    "Estimate",
    "HandTracker",
    "Kind",
    "LightSettings",
    "LossSettings",
    "Measured",
    "Memory",
    "NoiseSettings",
    "PosturePrior",
    "Rebasing",
    "SeenContour",
    "Status",
    "TrackerSettings",
    "TrackerState",
    "kind_of",
    "posed_belief",
    "posture_prior",
    "require",
    "require_positive",
    "start_spread",
]
