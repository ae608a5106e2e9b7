"""Pose and shape of an open hand from its outline: maximum a posteriori.

What differs from `fit_contour` is that the prior stays where it was, about people's mean shape, however often the fit
is continued.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.numerics.least_squares import LevenbergMarquardtSettings
from torchhand.numerics.levenberg_marquardt import levenberg_marquardt
from torchhand.track.open_hand_edges import OutlineEdges, match_edges
from torchhand.track.open_hand_problem import OpenHandProblem, linearized
from torchhand.track.open_hand_start import DigitResiduals

_BETWEEN_MATCHES = LevenbergMarquardtSettings(iterations=2, cost_tolerance=1e-3)


@dataclass(frozen=True, kw_only=True)
class OutlineFit:
    """Unknowns at the outline."""

    values: Float[Tensor, "n"]
    covariance: Float[Tensor, "n n"]
    """Covariance of the scaled unknowns."""
    edges: OutlineEdges
    """The edges that the values were last fitted to."""


def fit_outline(
    plane: Float[Tensor, "height width"],
    digits: DigitResiduals,
    problem: OpenHandProblem,
    start: Float[Tensor, "n"],
    *,
    reaches: Sequence[float],
    digit_weight: float,
) -> OutlineFit | None:
    """Moves the unknowns until the outer contour lies on the edge of a silhouette; None where there is no contour.

    In turn the contour is matched with edges within a reach, a fraction of the hand's length, and the unknowns are
    fitted to these edges, the digits and the prior. `digit_weight` is that of the digits' residuals.
    """
    values = start
    result: OutlineFit | None = None
    for reach in reaches:
        edges = match_edges(plane, problem, values, reach)
        if edges is None:
            break

        def residuals(hands: Tensor, edges: OutlineEdges = edges) -> Tensor:
            return torch.cat((edges.residuals(hands), digit_weight * digits(hands), problem.prior(hands)), -1)

        found = levenberg_marquardt(
            lambda hand, residuals=residuals: linearized(residuals, hand),
            values,
            lower=problem.lower,
            upper=problem.upper,
            settings=_BETWEEN_MATCHES,
        )
        values = found.values
        result = OutlineFit(values=values, covariance=torch.linalg.inv(found.matrix), edges=edges)
    return result
