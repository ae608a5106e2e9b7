"""The tracker: how a hand is found, followed through one camera or several, lost, found again and smoothed.

The package may be called: `torchhand.track(source, ...)` is `torchhand.runs.track`, the short way to the estimates of a
recording.
"""

import importlib
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

from torchhand.track.ahead import ScenesAhead, scenes_ahead
from torchhand.track.alternatives import Alternatives, TiltAlternatives
from torchhand.track.beside import STILL_SEARCHED, SearchBeside, opened_tracker
from torchhand.track.further_pass import FurtherPass
from torchhand.track.knowledge import Estimate, Keyframe, TrackerState, restored_state, saved_state
from torchhand.track.paths import HandPath, PosedHand, combined_hand, path_weights
from torchhand.track.proportions import FittedShape, reshaped_poses
from torchhand.track.proposals import OCCASIONS
from torchhand.track.scene import ONE_PLACE_M, HandKeypoints, View
from torchhand.track.settings import DEFAULTS, TrackerSettings
from torchhand.track.shape import FollowedFrame, can_tell_shape, frames_for_shape, recorded_shape
from torchhand.track.smoothing import PastFrame, Smoother
from torchhand.track.tracker import Tracker

__all__ = [
    "DEFAULTS",
    "OCCASIONS",
    "ONE_PLACE_M",
    "STILL_SEARCHED",
    "Alternatives",
    "Estimate",
    "FittedShape",
    "FollowedFrame",
    "FurtherPass",
    "HandKeypoints",
    "HandPath",
    "Keyframe",
    "PastFrame",
    "PosedHand",
    "ScenesAhead",
    "SearchBeside",
    "Smoother",
    "TiltAlternatives",
    "Tracker",
    "TrackerSettings",
    "TrackerState",
    "View",
    "can_tell_shape",
    "combined_hand",
    "frames_for_shape",
    "opened_tracker",
    "path_weights",
    "recorded_shape",
    "reshaped_poses",
    "restored_state",
    "saved_state",
    "scenes_ahead",
]


class _ShortWay(ModuleType):
    """This package as a function, so that one name serves both."""

    def __call__(self, source: Any, **options: Any) -> Iterator[Estimate]:
        return importlib.import_module("torchhand.runs").track(source, **options)


sys.modules[__name__].__class__ = _ShortWay
