"""Proportions of a hand that one camera follows: fitted to single frames together, while it is followed or after."""

from torchhand.track.proportions.fitted import SCHEDULE, FittedShape, fitted_shape, reshaped_poses
from torchhand.track.proportions.frame_fit import FrameFit, SeenFrame, contour_settings
from torchhand.track.proportions.outlines import OutlineShape

__all__ = [
    "SCHEDULE",
    "FittedShape",
    "FrameFit",
    "OutlineShape",
    "SeenFrame",
    "contour_settings",
    "fitted_shape",
    "reshaped_poses",
]
