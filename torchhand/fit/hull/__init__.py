"""Hands fitted into the hull and the silhouettes of several cameras (Ueda et al. 2003)."""

from torchhand.fit.hull.coverage import CoverageFactor, CoverageObservation
from torchhand.fit.hull.fitter import MIN_COVERED, HullEvidence, HullFitter
from torchhand.fit.hull.inside import InsideFactor, InsideObservation
from torchhand.fit.hull.joint_priors import JointPriors
from torchhand.fit.hull.rays import SilhouetteRays, silhouette_rays
from torchhand.fit.hull.settings import (
    SEARCH,
    TRACKING,
    HullSettings,
    HullShapeSettings,
    HullStartSettings,
    HullTorqueSettings,
    JointPriorWeights,
    TorqueSteps,
)
from torchhand.fit.hull.shape import fit_shape
from torchhand.fit.hull.skin import SkinPoints
from torchhand.fit.hull.start import HullStart, find_in_hull, finger_proposals, fit_proposals, palm_of
from torchhand.fit.hull.target import HullField, HullTarget, target_of, with_rays
from torchhand.fit.hull.torque import HullTorqueFit, fit_by_torques
from torchhand.fit.hull.vertices import SkinVertices

__all__ = [
    "MIN_COVERED",
    "SEARCH",
    "TRACKING",
    "CoverageFactor",
    "CoverageObservation",
    "HullEvidence",
    "HullField",
    "HullFitter",
    "HullSettings",
    "HullShapeSettings",
    "HullStart",
    "HullStartSettings",
    "HullTarget",
    "HullTorqueFit",
    "HullTorqueSettings",
    "InsideFactor",
    "InsideObservation",
    "JointPriorWeights",
    "JointPriors",
    "SilhouetteRays",
    "SkinPoints",
    "SkinVertices",
    "TorqueSteps",
    "find_in_hull",
    "finger_proposals",
    "fit_by_torques",
    "fit_proposals",
    "fit_shape",
    "palm_of",
    "silhouette_rays",
    "target_of",
    "with_rays",
]
