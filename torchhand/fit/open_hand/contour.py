"""Pose and shape of an open hand from its outline: maximum a posteriori.

What differs from `fit_contour` is that the prior stays where it was, about people's mean shape, however often the fit
is continued.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.open_hand.edges import Outline
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.settings import OpenHandSettings
from torchhand.fit.open_hand.start import DigitResiduals
from torchhand.numerics.least_squares import damped_box_step

_FINE_SHARE = 0.5  # of the iterations, the last, take the noise from the residuals
_GROSS = 3.0  # standard deviations beyond which a measured digit counts for less
_DAMPING = 0.05  # of a step's curvature, relative to the prior's


@dataclass(frozen=True, kw_only=True)
class OutlineFit:
    """Unknowns at the outline."""

    values: Float[Tensor, "n"]
    covariance: Float[Tensor, "n n"]
    """Of the scaled unknowns, about the last step."""
    residual_px: float
    """Median absolute distance of the found edges from the contour."""
    found_share: float
    """Share of the visible outer contour points at which an edge was found."""
    edge_std_px: float
    """Median of the standard deviations that edges were given, neighbours' agreement included."""


def fit_outline(
    outline: Outline,
    problem: OpenHandProblem,
    start: Float[Tensor, "n"],
    settings: OpenHandSettings,
    *,
    digits: DigitResiduals,
) -> OutlineFit | None:
    """Moves the unknowns until the outer contour lies on the silhouette's edge; None where hardly any edge is found."""
    values = problem.clamped(start)
    result: OutlineFit | None = None
    for iteration in range(settings.iterations):
        progress = iteration / (settings.iterations - 1)
        share = settings.search_share * (settings.final_search_share / settings.search_share) ** progress
        term = outline.term(values, share, is_fine=progress >= 1 - _FINE_SHARE)
        if term is None:
            return result
        known, slope = problem.prior(values)
        seen_digits, digit_slope = (settings.digit_share * rows for rows in digits.linearised(values))
        trust = _GROSS / seen_digits.abs().clamp_min(_GROSS)
        information = term.information + slope.T @ slope + digit_slope.T @ (trust[:, None] * digit_slope)
        pull = term.pull - slope.T @ known - digit_slope.T @ (trust * seen_digits)
        damping = torch.full((1,), _DAMPING * (1 - progress), dtype=values.dtype)
        below, above = (problem.lower - values)[None], (problem.upper - values)[None]
        step, _ = damped_box_step(information[None], -pull[None], damping, below, above)
        values = problem.clamped(values + step[0])
        result = OutlineFit(
            values=values,
            covariance=torch.linalg.inv(information),
            residual_px=term.residual_px,
            found_share=term.found_share,
            edge_std_px=term.edge_std_px,
        )
    return result
