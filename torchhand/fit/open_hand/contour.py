"""Pose and shape of an open hand from its outline: maximum a posteriori.

What differs from `fit_contour` is that the prior stays where it was, about people's mean shape, however often the fit
is continued.
"""

from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.open_hand.edges import OutlineEdges, match_edges
from torchhand.fit.open_hand.problem import OpenHandProblem, linearized
from torchhand.fit.open_hand.start import DigitResiduals
from torchhand.numerics import LevenbergMarquardtSettings, levenberg_marquardt

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
    rounds: int,
    digit_weight: float,
) -> OutlineFit | None:
    """Moves the unknowns until the outer contour lies on the edge of a silhouette; None where there is no contour.

    In every round the contour is matched with edges, and the unknowns are fitted to these, the digits and the prior;
    `digit_weight` is a factor on the digits' residuals.
    """

    def weighted_digits(values: Float[Tensor, "hands n"]) -> Float[Tensor, "hands rows"]:
        return digit_weight * digits(values)

    values = start
    result: OutlineFit | None = None
    for _ in range(rounds):
        edges = match_edges(plane, problem, values)
        if edges is None:
            break
        found = levenberg_marquardt(
            partial(linearized, (edges.residuals, weighted_digits, problem.prior)),
            values,
            lower=problem.lower,
            upper=problem.upper,
            settings=_BETWEEN_MATCHES,
        )
        values = found.values
        result = OutlineFit(values=values, covariance=torch.linalg.inv(found.matrix), edges=edges)
    return result
