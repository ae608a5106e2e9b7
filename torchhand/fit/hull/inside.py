"""The skin against the hull that the silhouettes leave: what sticks out of it (paper 002, section 5.1).

A visual hull holds the whole hand and more, so skin inside it tells nothing and skin outside is wrong. By itself this
is degenerate: any hand folded into the hull fits. `hull_covered` is the other side.
"""

from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor


@runtime_checkable
class HullField(Protocol):
    """Signed distance from a hull's surface, wherever it is asked for."""

    def sample(
        self, points: Float[Tensor, "*batch points 3"], /
    ) -> tuple[Float[Tensor, "*batch points"], Float[Tensor, "*batch points 3"]]:
        """Metres, negative inside, and its derivative in the place; finite for finite points, however far."""
        ...


@runtime_checkable
class PointMotion(Protocol):
    """Points of a batch of hands in the world, and how they move with the free parameters."""

    @property
    def points(self) -> Float[Tensor, "hands points 3"]:
        """Metres."""
        ...

    def along(self, direction: Float[Tensor, "hands points 3"]) -> Float[Tensor, "hands points free"]:
        """Derivative of direction · point in the free parameters, the direction held."""
        ...


def hull_inside_residual(
    motion: PointMotion, field: HullField, *, slack: float = 0.0
) -> tuple[Float[Tensor, "hands points"], Float[Tensor, "hands points free"]]:
    """How far each point is outside the hull, metres, and its derivative in the pose space; 0 within.

    slack: distance from the hull's surface up to which a point counts as within, metres; negative where the hull is
    known to be too large.
    """
    value, gradient = field.sample(motion.points)
    beyond = value - slack
    is_outside = beyond > 0
    rows = motion.along(torch.where(is_outside[..., None], gradient, 0.0))
    return torch.where(is_outside, beyond, 0.0), rows
