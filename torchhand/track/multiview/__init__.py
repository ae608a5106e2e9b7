"""Several cameras: silhouettes, their hull, a hand found in it without a guess, its proportions, and the MAP update."""

from torchhand.track.multiview.accumulated_shape import AccumulatedShape
from torchhand.track.multiview.fitting import FrameFitter, HullFit, best_of
from torchhand.track.multiview.hand_initialization import HandInitialization, evenly_spaced_frames, initialize_hand
from torchhand.track.multiview.hulls import Hull
from torchhand.track.multiview.initialization import Initialization, initialize
from torchhand.track.multiview.proposer import HandProposer
from torchhand.track.multiview.settings import HullOctreeSettings, RigSettings
from torchhand.track.multiview.update import EXPECTED_HULL, HULL, HullUpdate, expected_hull, hull_about, hull_anywhere

__all__ = [
    "EXPECTED_HULL",
    "HULL",
    "AccumulatedShape",
    "FrameFitter",
    "HandInitialization",
    "HandProposer",
    "Hull",
    "HullFit",
    "HullOctreeSettings",
    "HullUpdate",
    "Initialization",
    "RigSettings",
    "best_of",
    "evenly_spaced_frames",
    "expected_hull",
    "hull_about",
    "hull_anywhere",
    "initialize",
    "initialize_hand",
]
