"""Paper 002 as a tracker: several cameras, silhouettes, an octree's hull, and a skinned hand fitted into it."""

from torchhand.track.multiview.acquaintance import Acquaintance, acquaint, moments_of
from torchhand.track.multiview.agreement import score_of
from torchhand.track.multiview.fitting import Anchor
from torchhand.track.multiview.hindsight import Hindsight, SeenMoment
from torchhand.track.multiview.introduction import Introduction, introduce
from torchhand.track.multiview.saved import Knowledge, restored, saved
from torchhand.track.multiview.scale import in_unit
from torchhand.track.multiview.settings import HullOctreeSettings, MultiViewLossSettings, MultiViewSettings
from torchhand.track.multiview.silhouettes import Masks, ViewSilhouettes
from torchhand.track.multiview.tracker import MultiViewEstimate, MultiViewMemory, MultiViewTracker

__all__ = [
    "Acquaintance",
    "Anchor",
    "Hindsight",
    "HullOctreeSettings",
    "Introduction",
    "Knowledge",
    "Masks",
    "MultiViewEstimate",
    "MultiViewLossSettings",
    "MultiViewMemory",
    "MultiViewSettings",
    "MultiViewTracker",
    "SeenMoment",
    "ViewSilhouettes",
    "acquaint",
    "in_unit",
    "introduce",
    "moments_of",
    "restored",
    "saved",
    "score_of",
]
