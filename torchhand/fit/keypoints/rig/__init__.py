"""Keypoints of several cameras: which of them are one hand's, where they lie, and which cameras are late."""

from torchhand.fit.keypoints.rig.lag import ViewLag
from torchhand.fit.keypoints.rig.triangulation import Triangulated, triangulated

__all__ = ["Triangulated", "ViewLag", "triangulated"]
