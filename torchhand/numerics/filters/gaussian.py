"""The belief that the filters carry, a mean and a covariance, and what they correct it by."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.precision import record


@record()
@dataclass(frozen=True)
class Gaussian:
    """A normal distribution over a state of n numbers, one per batch entry."""

    mean: Float[Tensor, "*batch n"]
    covariance: Float[Tensor, "*batch n n"]  # symmetric positive semi-definite

    @property
    def std(self) -> Float[Tensor, "*batch n"]:
        """Standard deviation of every component; a diagonal entry that rounding left below 0 counts as 0."""
        return self.covariance.diagonal(dim1=-2, dim2=-1).clamp_min(0.0).sqrt()


@record()
@dataclass(frozen=True)
class Measurement:
    """Numbers measured at once, one row per batch entry. Raises ValueError for noise in another dtype than the value.

    Whatever number or NaN stands where a measurement is not valid has no effect.
    """

    value: Float[Tensor, "*batch m"]
    noise: Float[Tensor, "..."]
    """Variances (*batch, m) of independent noises, or covariances (*batch, m, m); above 0."""
    valid: Bool[Tensor, "*#batch m"] | None = None
    """False leaves a measurement out; None: all count."""

    def __post_init__(self) -> None:
        if self.noise.dtype is not self.value.dtype:
            raise ValueError(f"noise: expected {self.value.dtype}, that of the value, got {self.noise.dtype}")
