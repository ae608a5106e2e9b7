"""Is a filter as sure as it may be? Normalised squared errors and the chi-square band they should stay in."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.numerics.filters.cholesky import robust_cholesky
from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.precision import full_precision


@full_precision
def nees(estimate: Gaussian, truth: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch"]:
    """Normalised estimation error squared eᵀ P⁻¹ e, e = truth - mean; chi-square with n degrees if P is honest."""
    return _normalised_square(truth - estimate.mean, estimate.covariance)


@full_precision
def nis(innovation: Float[Tensor, "*batch m"], covariance: Float[Tensor, "*batch m m"]) -> Float[Tensor, "*batch"]:
    """Normalised innovation squared νᵀ S⁻¹ ν for a full S; `Update.nis` has it without forming S."""
    return _normalised_square(innovation, covariance)


def chi_square_quantile(probability: float, degrees: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """The value that a chi-square variable of so many degrees (> 0) stays below with this probability in (0, 1).

    Bisection of the regularised incomplete gamma function, to the last digits of float64.
    """
    if not 0 < probability < 1:
        raise ValueError(f"probability must be between 0 and 1, got {probability!r}")
    if not bool((degrees > 0).all()):
        raise ValueError("degrees must be above 0 everywhere")
    shape = degrees.double() / 2
    low = torch.zeros_like(shape)
    high = torch.ones_like(shape)
    while bool((grow := torch.special.gammainc(shape, high) < probability).any()):
        high = torch.where(grow, 2 * high, high)
    for _ in range(64):
        middle = 0.5 * (low + high)
        is_low = torch.special.gammainc(shape, middle) < probability
        low, high = torch.where(is_low, middle, low), torch.where(is_low, high, middle)
    return (low + high).to(degrees.dtype)


def mean_chi_square_band(degrees: int, count: int, level: float = 0.95) -> tuple[float, float]:
    """Bounds that the mean of `count` independent NEES or NIS values, each of `degrees`, keeps with this probability.

    The bounds leave (1 - level) / 2 outside at either end. Values of one sequence are correlated in time, which makes
    their mean scatter more; take one value per independent run.
    """
    if degrees < 1 or count < 1:
        raise ValueError(f"degrees and count must be 1 or more, got degrees={degrees}, count={count}")
    if not 0 < level < 1:
        raise ValueError(f"level must be between 0 and 1, got {level!r}")
    total = torch.tensor(float(degrees * count), dtype=torch.float64)
    low, high = (chi_square_quantile(p, total) / count for p in ((1 - level) / 2, (1 + level) / 2))
    return float(low), float(high)


def _normalised_square(error: Float[Tensor, "*batch n"], covariance: Float[Tensor, "*batch n n"]) -> Tensor:
    factor = robust_cholesky(covariance)
    return torch.linalg.solve_triangular(factor, error.unsqueeze(-1), upper=False).square().sum((-2, -1))
