"""The belief that the filters carry: a mean and a covariance."""

from dataclasses import dataclass

from jaxtyping import Float
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
