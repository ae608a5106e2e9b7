"""What a registration gives: a pose for every hypothesis, with how it ended."""

from dataclasses import dataclass, fields
from enum import IntEnum

from jaxtyping import Float, Int
from torch import Tensor

from torchhand.numerics import Status


class RegistrationStatus(IntEnum):
    """How a hypothesis ended."""

    CONVERGED = Status.CONVERGED.value
    """No step promises a noticeable decrease of the cost."""
    STALLED = Status.STALLED.value
    """Out of iterations: the best pose found."""
    FAILED = Status.FAILED.value
    """Nothing of the model was ever in sight, or the start was not finite: the start."""
    NO_CONTOUR = 3
    """The picture has no contour to register on: the start."""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Registered hands, one per hypothesis, in the world."""

    pose: Float[Tensor, "*hypotheses 36"]
    """Metres and radians, with a zero rotation vector, within the limits."""
    root_reference: Float[Tensor, "*hypotheses 3 3"]
    """world_from_hand"""
    cost: Float[Tensor, "*hypotheses"]
    """Half the weighted sum of the robust losses at the finest level: comparable between hypotheses; infinite if
    failed."""
    contour_px: Float[Tensor, "*hypotheses"]
    """Mean distance of the picture's contour from the model's outline, px, cut off at the finest level's robust scale;
    infinite if failed."""
    status: Int[Tensor, "*hypotheses"]
    """Numbers of `RegistrationStatus`."""
    iterations: Int[Tensor, "*hypotheses"]
    """Evaluations over all looks."""
    covariance: Float[Tensor, "*hypotheses free free"]
    """Of the free parameters, the rotation as a left perturbation of the root reference; NaN if failed."""

    @property
    def best(self) -> int:
        """Place of the lowest cost among the flattened hypotheses."""
        return int(self.cost.reshape(-1).argmin())

    def select(self, index: int) -> "Registration":
        """One of the flattened hypotheses, without batch dimensions."""
        lead = self.status.ndim
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return Registration(**{name: value.reshape(-1, *value.shape[lead:])[index] for name, value in values.items()})
