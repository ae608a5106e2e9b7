"""The contour tracker: an unscented Kalman filter on edges along the normals of the contour."""

from torchhand.track.unscented.contour_tracker import ContourTracker

__all__ = [
    "ContourTracker",
]
