"""From residuals of different kinds to one set of normal equations per hand."""

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.numerics import NormalEquations, RobustLoss


def weighted_equations(
    residual: Float[Tensor, "*batch m"],
    jacobian: Float[Tensor, "*batch m free"],
    weight: Float[Tensor, "*#batch m"] | None = None,
    robust: RobustLoss | None = None,
) -> NormalEquations:
    """Normal equations of ½ Σ weight · ρ(residual): reweighted least squares, the gradient is exact. Groups of a loss
    are of one.

    Residuals of weight 0 may be infinite or NaN, their derivatives not: they do not count.
    """
    if weight is not None:
        residual = torch.where(weight == 0, 0.0, residual)
    if robust is None and weight is None:
        gradient = (residual[..., None, :] @ jacobian).squeeze(-2)
        return NormalEquations(matrix=jacobian.mT @ jacobian, gradient=gradient, cost=0.5 * residual.square().sum(-1))
    if robust is None:
        loss, slope = residual.square(), torch.ones_like(residual)
    else:
        loss, slope = _each(robust, residual)
    if weight is not None:
        loss, slope = loss * weight, slope * weight
    weighted = slope[..., None] * jacobian
    return NormalEquations(
        matrix=weighted.mT @ jacobian,
        gradient=(residual[..., None, :] @ weighted).squeeze(-2),
        cost=0.5 * loss.sum(-1),
    )


def summed(terms: Iterable[NormalEquations]) -> NormalEquations:
    """The equations of the sum of costs; at least one."""
    first, *rest = terms
    matrix, gradient, cost = first.matrix, first.gradient, first.cost
    for term in rest:
        matrix, gradient, cost = matrix + term.matrix, gradient + term.gradient, cost + term.cost
    return NormalEquations(matrix=matrix, gradient=gradient, cost=cost)


def _each(robust: RobustLoss, residual: Tensor) -> tuple[Tensor, Tensor]:
    """The loss (twice its half) and the weight of every residual by itself."""
    cost, weight = robust.cost_and_weights(residual[..., None])
    return 2 * cost, weight.squeeze(-1)
