"""The normalised estimation error squared against the chi-square distribution; how well probabilities tell apart."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.numerics import chi_square_quantile, mean_chi_square_band

RELATIVE_RANK_TOLERANCE = 1e-9
"""Eigenvalues below this share of the largest are directions that the estimate never moves in."""


@dataclass(frozen=True, kw_only=True)
class Consistency:
    """A consistent filter has fraction_inside near 0.95 and mean_per_dof near 1; above 1 it claims too much."""

    samples: int
    """Points with a known error and a covariance that is not zero."""
    fraction_inside: float
    """Share of the points whose NEES lies inside the two-sided 95 % band of its degrees of freedom."""
    mean_per_dof: float
    """Sum of all NEES over the sum of their degrees of freedom."""
    pooled_band: tuple[float, float]
    """95 % band of mean_per_dof if all samples were independent; points of one frame are not, so it is narrow."""
    mean_rank: float
    """3 where every covariance is full; less where a pose space cannot move in all directions (a planar hand)."""


def normalised_errors_squared(
    errors: Float[np.ndarray, "*batch d"], covariance: Float[np.ndarray, "*batch d d"]
) -> tuple[Float[np.ndarray, "*batch"], Int[np.ndarray, "*batch"]]:
    """NEES eᵀ P⁻¹ e, and its degrees of freedom.

    A covariance without full rank is inverted in the space that it spans, and the degrees of freedom are its rank. NaN
    and rank 0 where error or covariance is unknown, or the covariance is zero.
    """
    is_known = np.isfinite(errors).all(axis=-1) & np.isfinite(covariance).all(axis=(-2, -1))
    symmetric = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    variance, directions = np.linalg.eigh(np.where(np.expand_dims(is_known, (-2, -1)), symmetric, 0.0))
    along = (np.swapaxes(directions, -1, -2) @ np.where(np.expand_dims(is_known, -1), errors, 0.0)[..., None])[..., 0]
    largest = variance[..., -1:]
    is_spanned = (variance > RELATIVE_RANK_TOLERANCE * largest) & (largest > 0)
    terms = np.where(is_spanned, along**2 / np.where(is_spanned, variance, 1.0), 0.0)
    rank = np.asarray(is_spanned.sum(axis=-1))
    return np.asarray(np.where(rank > 0, terms.sum(axis=-1), np.nan)), rank


def fraction_in_band(
    errors: Float[np.ndarray, "*batch d"], covariance: Float[np.ndarray, "*batch d d"]
) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch"]]:
    """1 where a point lies inside the region that holds it with a probability of 95 %, else 0, and the weight that it
    counts with: 0 where error or covariance is unknown, or the covariance is zero."""
    nees, rank = normalised_errors_squared(errors, covariance)
    dof = torch.arange(1, errors.shape[-1] + 1, dtype=torch.float64)
    highest = chi_square_quantile(0.95, dof).numpy()[np.maximum(rank, 1) - 1]
    is_known = rank > 0
    return (is_known & (np.nan_to_num(nees, nan=np.inf) <= highest)).astype(float), is_known.astype(float)


def area_under_curve(told: Float[Tensor, "n"], is_right: Bool[Tensor, "n"]) -> float:
    """Probability that a right one was told a higher probability than a wrong one; ties count half. NaN where there are
    none of either."""
    right, wrong = told[is_right], told[~is_right].sort().values
    if not len(right) or not len(wrong):
        return math.nan
    below = torch.searchsorted(wrong, right, right=False) + torch.searchsorted(wrong, right, right=True)
    return float(below.double().mean()) / (2 * len(wrong))


def consistency(
    errors: Float[np.ndarray, "*batch d"], covariance: Float[np.ndarray, "*batch d d"]
) -> Consistency | None:
    """Summary over all points and frames; None if no covariance is known or all are zero."""
    nees, rank = normalised_errors_squared(errors, covariance)
    nees, rank = nees[rank > 0], rank[rank > 0]
    if nees.size == 0:
        return None
    dof = torch.arange(1, errors.shape[-1] + 1, dtype=torch.float64)
    low, high = (chi_square_quantile(probability, dof).numpy()[rank - 1] for probability in (0.025, 0.975))
    is_inside = (low <= nees) & (nees <= high)
    total_dof = int(rank.sum())
    return Consistency(
        samples=int(nees.size),
        fraction_inside=float(is_inside.mean()),
        mean_per_dof=float(nees.sum() / total_dof),
        pooled_band=mean_chi_square_band(1, total_dof),
        mean_rank=float(rank.mean()),
    )
