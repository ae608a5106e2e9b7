"""Costs of the points of a contour in the picture, to second order."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class PointToLineTerms:
    """Some terms at every point of a batch of contours, each of the distance along a direction of its own.

    Where a point moves by d px, a cost changes by Σ gradient (direction · d) + ½ curvature (direction · d)². A residual
    r with derivative `direction` and weight w has the gradient w r and the curvature w. Residuals at the points of a
    contour so become normal equations in the pose without a row of a Jacobian for each.
    """

    direction: Float[Tensor, "hands terms 2 points"]
    curvature: Float[Tensor, "hands terms points"]
    gradient: Float[Tensor, "hands terms points"]
