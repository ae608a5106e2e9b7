"""Normal equations of weighted, robust residuals: gradient against autograd, weights, sums."""

import pytest
import torch

from torchhand.fit.equations import summed, weighted_equations
from torchhand.numerics import RobustLoss


@pytest.mark.parametrize("kind", ["none", "huber", "geman_mcclure"])
def test_gradient_is_exact_and_the_matrix_that_of_reweighted_squares(kind: str, generator: torch.Generator) -> None:
    robust = None if kind == "none" else RobustLoss(kind="huber" if kind == "huber" else "geman_mcclure", scale=0.7)
    jacobian = torch.randn(2, 9, 4, generator=generator, dtype=torch.float64)
    weight = torch.rand(2, 9, generator=generator, dtype=torch.float64)
    free = torch.randn(2, 4, generator=generator, dtype=torch.float64, requires_grad=True)

    def residual(x: torch.Tensor) -> torch.Tensor:
        return (jacobian @ x[..., None]).squeeze(-1) - 0.3

    found = weighted_equations(residual(free), jacobian, weight, robust)
    expected = torch.autograd.grad(found.cost.sum(), free)[0]
    torch.testing.assert_close(found.gradient, expected)
    squared = residual(free).detach().square()
    fraction = {"none": torch.ones_like(squared), "huber": (squared / 0.49).clamp_min(1).rsqrt()}
    slope = fraction.get(kind, (1 + squared / 0.49).square().reciprocal()) * weight
    torch.testing.assert_close(found.matrix, jacobian.mT @ (slope[..., None] * jacobian))


def test_weight_zero_does_not_count_whatever_the_residual() -> None:
    residual = torch.tensor([1.0, torch.nan, torch.inf], dtype=torch.float64)
    jacobian = torch.ones(3, 2, dtype=torch.float64)
    weight = torch.tensor([2.0, 0.0, 0.0], dtype=torch.float64)
    found = weighted_equations(residual, jacobian, weight, RobustLoss(kind="squares"))
    assert float(found.cost) == 1.0
    assert found.gradient.tolist() == [2.0, 2.0]


def test_sums_add_everything(generator: torch.Generator) -> None:
    parts = [
        weighted_equations(torch.randn(3, 5, generator=generator), torch.randn(3, 5, 2, generator=generator))
        for _ in range(3)
    ]
    whole = summed(parts)
    torch.testing.assert_close(whole.cost, sum(part.cost for part in parts))
    torch.testing.assert_close(whole.matrix, sum(part.matrix for part in parts))
    torch.testing.assert_close(whole.gradient, sum(part.gradient for part in parts))
