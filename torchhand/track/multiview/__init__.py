"""Several cameras: silhouettes, their hull, a hand found in it without a guess, its proportions, and the MAP update."""

from torchhand.track.multiview.acquaintance import Acquaintance, acquaint, moments_of
from torchhand.track.multiview.fitting import Anchor, MomentFitter, Placed, score_of
from torchhand.track.multiview.hulls import Hull
from torchhand.track.multiview.introduction import Introduction, introduce
from torchhand.track.multiview.scale import in_unit
from torchhand.track.multiview.settings import HullOctreeSettings, RigSettings
from torchhand.track.multiview.update import HullUpdate, anchor_of, hull_about, hull_anywhere

__all__ = [
    "Acquaintance",
    "Anchor",
    "Hull",
    "HullOctreeSettings",
    "HullUpdate",
    "Introduction",
    "MomentFitter",
    "Placed",
    "RigSettings",
    "acquaint",
    "anchor_of",
    "hull_about",
    "hull_anywhere",
    "in_unit",
    "introduce",
    "moments_of",
    "score_of",
]
