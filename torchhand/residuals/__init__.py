"""One observation, one pure function: what a posed hand is compared with, as residuals and their derivatives."""

from torchhand.residuals.coverage import coverage_residual, match_boundary
from torchhand.residuals.equations import summed, weighted_equations
from torchhand.residuals.limits import DynamicConstraints, limit_residual
from torchhand.residuals.outer_contour import outer_contour_residual
from torchhand.residuals.posture import PostureResiduals
from torchhand.residuals.smoothness import Expectation, smoothness_residual
from torchhand.residuals.valley import valley_residual

__all__ = [
    "DynamicConstraints",
    "Expectation",
    "PostureResiduals",
    "coverage_residual",
    "limit_residual",
    "match_boundary",
    "outer_contour_residual",
    "smoothness_residual",
    "summed",
    "valley_residual",
    "weighted_equations",
]
