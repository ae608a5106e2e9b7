"""Paper 002 as a tracker: several cameras, silhouettes, an octree's hull, and a skinned hand fitted into it."""

from torchhand.track.multiview.acquaintance import Acquaintance, acquaint, moments_of
from torchhand.track.multiview.hindsight import Hindsight, SeenMoment
from torchhand.track.multiview.settings import HullOctreeSettings, MultiViewLossSettings, MultiViewSettings
from torchhand.track.multiview.silhouettes import ViewSilhouettes
from torchhand.track.multiview.tracker import MultiViewMemory, MultiViewTracker

__all__ = [
    "Acquaintance",
    "Hindsight",
    "HullOctreeSettings",
    "MultiViewLossSettings",
    "MultiViewMemory",
    "MultiViewSettings",
    "MultiViewTracker",
    "SeenMoment",
    "ViewSilhouettes",
    "acquaint",
    "moments_of",
]
