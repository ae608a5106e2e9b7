"""What pulls at the points of a contour in the picture, to second order."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Springs:
    """Some springs at every point of a batch of hands, each along its own direction in the picture.

    Where the points move by d px, a cost changes by Σ pull (direction · d) + ½ stiffness (direction · d)²: of a
    residual r with derivative `direction` and weight w these are w r and w. So residuals on the points of a contour
    become normal equations in the pose without a row of a Jacobian for each.
    """

    direction: Float[Tensor, "hands springs 2 points"]
    stiffness: Float[Tensor, "hands springs points"]
    pull: Float[Tensor, "hands springs points"]
