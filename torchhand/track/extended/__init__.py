"""The distance-map tracker: an extended Kalman filter on segments between contour and edges."""

from torchhand.track.extended.distance_tracker import DistanceTracker
from torchhand.track.extended.settings import DistanceTrackerSettings

__all__ = [
    "DistanceTracker",
    "DistanceTrackerSettings",
]
