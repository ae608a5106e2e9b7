"""Means over what is there: NaN entries (lost frames) are skipped, and a mean of nothing is NaN, without a warning."""

import numpy as np
from jaxtyping import Bool, Float


def mean_finite(values: Float[np.ndarray, "..."]) -> float:
    """Mean of the finite entries."""
    kept = values[np.isfinite(values)]
    return float(kept.mean()) if kept.size else float("nan")


def rms_finite(values: Float[np.ndarray, "..."]) -> float:
    """Root mean square of the finite entries."""
    return float(np.sqrt(mean_finite(values**2)))


def median_finite(values: Float[np.ndarray, "..."]) -> float:
    """Median of the finite entries."""
    kept = values[np.isfinite(values)]
    return float(np.median(kept)) if kept.size else float("nan")


def max_finite(values: Float[np.ndarray, "..."]) -> float:
    """Largest of the finite entries' magnitudes."""
    kept = values[np.isfinite(values)]
    return float(np.abs(kept).max()) if kept.size else float("nan")


def is_finite_set(points: Float[np.ndarray, "*batch n d"]) -> Bool[np.ndarray, "*batch"]:
    """True where a whole set of points is finite."""
    return np.asarray(np.isfinite(points).all(axis=(-2, -1)))
