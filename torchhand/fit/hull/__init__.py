"""Hands fitted into the hull and the silhouettes of several cameras."""

from torchhand.fit.hull.fit import HullFit, HullFitter
from torchhand.fit.hull.points import HullTarget, target_of, with_rims
from torchhand.fit.hull.rims import HullRims, rims_of
from torchhand.fit.hull.settings import (
    HULL_TRACKING_LEVELS,
    HullFitSettings,
    HullLevel,
    HullShapeSettings,
    HullStartSettings,
    HullTorqueSettings,
    TorqueSteps,
)
from torchhand.fit.hull.shape import HullShapeFit, fit_shape
from torchhand.fit.hull.skin import SkinPoints
from torchhand.fit.hull.start import find_in_hull, palm_of, varied_digits
from torchhand.fit.hull.torque import HullTorqueFit, fit_by_torques

__all__ = [
    "HULL_TRACKING_LEVELS",
    "HullFit",
    "HullFitSettings",
    "HullFitter",
    "HullLevel",
    "HullRims",
    "HullShapeFit",
    "HullShapeSettings",
    "HullStartSettings",
    "HullTarget",
    "HullTorqueFit",
    "HullTorqueSettings",
    "SkinPoints",
    "TorqueSteps",
    "find_in_hull",
    "fit_by_torques",
    "fit_shape",
    "palm_of",
    "rims_of",
    "target_of",
    "varied_digits",
    "with_rims",
]
