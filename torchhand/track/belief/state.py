"""What is believed of a hand that is followed, between two frames."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchhand.numerics.filters import Gaussian


@dataclass(frozen=True, kw_only=True)
class FollowedHand:
    """A hand that is followed from frame to frame; world frame."""

    belief: Gaussian
    """Over [free, free', free'']: changes from `base`, the root's rotation a left perturbation of `reference`."""
    base: Float[Tensor, "36"]
    """Pose that the free parameters are changes from; metres and radians."""
    reference: Float[Tensor, "3 3"]
    """world_from_hand of the last estimate."""
    start_reference: Float[Tensor, "3 3"]
    """world_from_hand where the hand was found."""
    failures: int = 0
    """Frames in a row that did not bear the hand out."""
    density: Float[Tensor, "free"] | None = None
    """Spectral density of the process noise as learned so far; None where it is not learned."""
    dt_s: float = 0.0
    """Time step of the last prediction, seconds."""
    direction: float | None = None
    """How far a network bore out the direction of the hand lately, 0 to 1; None where it was not asked."""
    frames: int = 0
    """Frames since the hand was found."""
