"""Sigma points: a small weighted set of states with the mean and covariance of a Gaussian."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.numerics.filters.cholesky import robust_cholesky
from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.precision import full_precision


@dataclass(frozen=True, kw_only=True)
class UnscentedSettings:
    """Which sigma points the unscented transform uses.

    "scaled"    van der Merwe's set with alpha, beta, kappa; alpha = 1 and beta = 0 make it Julier's set with kappa.
    "kappa"     2n + 1 equal weights, spread sqrt(n + 1/2): the printed set of Stenger et al. (2001) made exact.
    "julier95"  2n equal weights, spread sqrt(n); the centre has weight 0.
    "paper"     as printed in Stenger et al. (2001): 2n + 1 equal weights, spread sqrt(n). Its covariance is
                2n / (2n + 1) of the true one, so a prediction shrinks a little and an update gains a little less.
    """

    variant: Literal["scaled", "kappa", "julier95", "paper"] = "scaled"
    alpha: float = 1.0  # spread, scaled only; small values lose digits (avoid below 0.1 in float32)
    beta: float = 2.0  # weight of the centre in covariances, scaled only; 2 suits a Gaussian
    kappa: float = 0.0  # spread, scaled only; above -n

    def __post_init__(self) -> None:
        if self.variant not in ("scaled", "kappa", "julier95", "paper"):
            raise ValueError(f"variant must be 'scaled', 'kappa', 'julier95' or 'paper', got {self.variant!r}")
        if not (self.alpha > 0 and math.isfinite(self.alpha)):
            raise ValueError(f"alpha must be above 0, got {self.alpha!r}")
        for name, value in (("beta", self.beta), ("kappa", self.kappa)):
            if not math.isfinite(value):
                raise ValueError(f"{name} must be finite, got {value!r}")


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Spread and weights of a set of 2n + 1 points; all but the centre weigh the same."""

    spread: float  # offsets are this times the columns of the Cholesky factor
    outer: float  # weight of each of the 2n outer points
    centre_mean: float  # weight of the centre in a mean
    centre_covariance: float  # weight of the centre in a covariance

    @classmethod
    def of(cls, settings: UnscentedSettings, size: int) -> "Weights":
        """Weights for a state of `size` numbers; ValueError when kappa <= -size."""
        if settings.variant == "scaled":
            if not size + settings.kappa > 0:
                raise ValueError(f"kappa must be above -{size} for a state of {size} numbers, got {settings.kappa!r}")
            spread2 = settings.alpha**2 * (size + settings.kappa)
            mean = 1.0 - size / spread2
            covariance = mean + 1.0 - settings.alpha**2 + settings.beta
            return cls(spread=math.sqrt(spread2), outer=0.5 / spread2, centre_mean=mean, centre_covariance=covariance)
        if settings.variant == "julier95":
            return cls(spread=math.sqrt(size), outer=0.5 / size, centre_mean=0.0, centre_covariance=0.0)
        equal = 1.0 / (2 * size + 1)
        spread2 = size + (0.5 if settings.variant == "kappa" else 0.0)
        return cls(spread=math.sqrt(spread2), outer=equal, centre_mean=equal, centre_covariance=equal)

    @property
    def is_exact(self) -> bool:
        """Whether the set has the covariance it was drawn from."""
        return math.isclose(self.covariance_ratio, 1.0, rel_tol=1e-12)

    @property
    def covariance_ratio(self) -> float:
        """Covariance of the set over the covariance it was drawn from."""
        return 2.0 * self.outer * self.spread**2


class SigmaPoints(NamedTuple):
    """The centre, then n points along +, then n along - the columns of the lower Cholesky factor."""

    points: Tensor  # (*batch, 2n + 1, n)
    mean_weights: Tensor  # (2n + 1,)
    covariance_weights: Tensor  # (2n + 1,)


@full_precision
def sigma_points(state: Gaussian, settings: UnscentedSettings) -> SigmaPoints:
    """Draw the sigma points of a Gaussian; its covariance may be singular."""
    size = state.mean.shape[-1]
    weights = Weights.of(settings, size)
    points = spread_points(state.mean, weights.spread * robust_cholesky(state.covariance))
    mean_weights = points.new_full((2 * size + 1,), weights.outer)
    covariance_weights = mean_weights.clone()
    mean_weights[0] = weights.centre_mean
    covariance_weights[0] = weights.centre_covariance
    return SigmaPoints(points, mean_weights, covariance_weights)


def spread_points(centre: Float[Tensor, "*batch n"], offsets: Float[Tensor, "*batch n k"]) -> Tensor:
    """The centre, the centre plus each column, the centre minus each column: (*batch, 2k + 1, n)."""
    middle = centre.unsqueeze(-2)
    return torch.cat([middle, middle + offsets.mT, middle - offsets.mT], dim=-2)
