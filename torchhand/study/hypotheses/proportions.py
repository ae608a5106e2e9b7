"""Statistics of success: the interval of a share, what the best of several tries gives, quantiles over failures."""

import math

import numpy as np
from jaxtyping import Bool, Float

Z_95 = 1.959963984540054
"""Two-sided 95 % quantile of the standard normal distribution."""


def wilson_interval(successes: int, trials: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson's score interval (1927) of a proportion, 95 % unless z says otherwise; (0, 1) of no trial at all."""
    if not 0 <= successes <= trials:
        raise ValueError(f"successes: expected 0 to {trials}, got {successes}")
    if trials == 0:
        return 0.0, 1.0
    fraction, spread = successes / trials, z * z / trials
    centre = (fraction + 0.5 * spread) / (1 + spread)
    half = z * math.sqrt(fraction * (1 - fraction) / trials + 0.25 * spread / trials) / (1 + spread)
    return max(0.0, centre - half), min(1.0, centre + half)


def rank_weights(count: int, tries: int) -> Float[np.ndarray, "count"]:
    """Probability of each rank, the best first, to be the best of `tries` of `count`, drawn without replacement.

    C(count - 1 - rank, tries - 1) / C(count, tries), as a product of ratios.
    """
    if not 1 <= tries <= count:
        raise ValueError(f"tries: expected 1 to {count}, got {tries}")
    rank = np.arange(count - 1)
    ratio = np.maximum(count - rank - tries, 0) / (count - 1 - rank)
    return (tries / count) * np.cumprod(np.concatenate(([1.0], ratio)))


def success_of_best(misfit: Float[np.ndarray, "starts"], is_success: Bool[np.ndarray, "starts"], tries: int) -> float:
    """Expected success of the best of `tries` starts, by their misfits: the mean over all choices of so many of them.

    Misfits on one picture; infinite ones are failures. NaN where there are fewer starts. Of equal ones the first wins.
    """
    if tries > len(misfit):
        return float("nan")
    order = np.argsort(misfit, kind="stable")
    return float(rank_weights(len(misfit), tries) @ is_success[order])


def quantile_with_failures(values: Float[np.ndarray, "starts"], fraction: float) -> float:
    """The smallest value that at least this share of them do not exceed; what is not finite counts as infinite.

    NaN of no values at all.
    """
    if not 0 < fraction <= 1:
        raise ValueError(f"fraction: expected above 0, to 1, got {fraction!r}")
    if not len(values):
        return float("nan")
    ordered = np.sort(np.where(np.isfinite(values), values, np.inf))
    return float(ordered[math.ceil(fraction * len(values) - 1e-9) - 1])
