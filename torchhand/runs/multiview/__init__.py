"""A run with the pictures of several cameras."""

from torchhand.runs.multiview.request import RigRequest
from torchhand.runs.multiview.tracking import MultiViewRun, track_rig

__all__ = [
    "MultiViewRun",
    "RigRequest",
    "track_rig",
]
