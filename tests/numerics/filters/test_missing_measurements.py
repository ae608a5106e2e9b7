"""One rule for all filters: a measurement that is not finite is a missing measurement."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.numerics.filters.linearised import linearised
from torchhand.numerics.filters.extended import update_extended
from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.iterated import update_iterated
from torchhand.numerics.filters.unscented import Update, update

SIZE, ROWS = 4, 9


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


MIX = randn(ROWS, SIZE, seed=42)


def observe(points: Tensor) -> Tensor:
    return (0.5 * points @ MIX.mT).sin() + 0.1 * points @ MIX.mT


def unscented(
    state: Gaussian, seen: Callable[[Tensor], Tensor], z: Tensor, r: Tensor, valid: Tensor | None = None, **options: Any
) -> Update:
    return update(state, seen, Measurement(z, r, valid), **options)


def extended(state: Gaussian, seen: Callable[[Tensor], Tensor], z: Tensor, r: Tensor, **options: Any) -> Update:
    value, jacobian = linearised(seen)(state.mean)
    return update_extended(state, z - value, jacobian, r, **options)


def extended_correlated(state: Gaussian, seen: Any, z: Tensor, r: Tensor, **options: Any) -> Update:
    value, jacobian = linearised(seen)(state.mean)
    holes = r.isnan().unsqueeze(-1) | r.isnan().unsqueeze(-2)
    noise = torch.where(holes, torch.nan, r.nan_to_num(1.0).diag_embed() + 0.01)
    return update_extended(state, z - value, jacobian, noise, **options)


def iterated(
    state: Gaussian, seen: Callable[[Tensor], Tensor], z: Tensor, r: Tensor, valid: Tensor | None = None, **options: Any
) -> Update:
    return update_iterated(state, linearised(seen), Measurement(z, r, valid), **options).update


FILTERS = [unscented, extended, extended_correlated, iterated]


def problem() -> tuple[Gaussian, Tensor, Tensor]:
    root = 0.3 * randn(2, SIZE, SIZE, seed=1)
    state = Gaussian(randn(2, SIZE, seed=2), root @ root.mT + 0.01 * torch.eye(SIZE, dtype=torch.float64))
    return state, observe(state.mean) + 0.3 * randn(2, ROWS, seed=3), 0.05 + randn(2, ROWS, seed=4).square()


def same(got: Update, expected: Update) -> None:
    assert torch.equal(got.used, expected.used)
    assert torch.equal(got.count, expected.count)
    for mine, other in (
        (got.state.mean, expected.state.mean),
        (got.state.covariance, expected.state.covariance),
        (got.nis, expected.nis),
        (got.innovation, expected.innovation),
    ):
        assert mine.isfinite().all()
        assert torch.allclose(mine, other, rtol=0, atol=1e-13)
    assert torch.equal(got.innovation_variance.isinf(), expected.innovation_variance.isinf())


@pytest.mark.parametrize("filtered", FILTERS)
@pytest.mark.parametrize("gate", [None, 9.0])
@pytest.mark.parametrize("hole", [torch.nan, torch.inf, -torch.inf])
def test_a_measurement_that_is_not_finite_is_a_missing_one(filtered: Any, gate: float | None, hole: float) -> None:
    state, z, r = problem()
    valid = torch.ones(2, ROWS, dtype=torch.bool)
    valid[0, 2] = valid[1, 0] = valid[1, 7] = False
    also = valid.clone()
    also[0, 5] = False  # a flag and a hole are of the same kind
    expected = filtered(state, observe, z, r, valid=also, gate=gate)
    same(filtered(state, observe, z.where(valid, hole), r, valid=also | ~valid, gate=gate), expected)
    same(filtered(state, observe, z.where(also, hole), r, gate=gate), expected)
    same(filtered(state, observe, z.where(also, hole), r.where(also, torch.nan), gate=gate), expected)


@pytest.mark.parametrize("filtered", FILTERS)
@pytest.mark.parametrize("gate", [None, 9.0])
def test_a_measurement_that_cannot_be_predicted_is_a_missing_one(filtered: Any, gate: float | None) -> None:
    state, z, r = problem()
    valid = torch.arange(ROWS).expand(2, ROWS) % 4 != 1

    def blind(points: Tensor) -> Tensor:
        return observe(points).where(torch.arange(ROWS) % 4 != 1, torch.nan)

    same(filtered(state, blind, z, r, gate=gate), filtered(state, observe, z, r, valid=valid, gate=gate))


@pytest.mark.parametrize("filtered", FILTERS)
@pytest.mark.parametrize("gate", [None, 9.0])
def test_without_a_finite_measurement_nothing_changes(filtered: Any, gate: float | None) -> None:
    state, z, r = problem()
    z[1] = torch.nan
    got = filtered(state, observe, z, r, gate=gate)
    assert torch.equal(got.state.mean[1], state.mean[1])
    assert torch.equal(got.state.covariance[1], state.covariance[1])
    assert float(got.nis[1]) == 0
    assert not torch.equal(got.state.mean[0], state.mean[0])
    assert got.state.mean[0].isfinite().all()


@pytest.mark.parametrize("filtered", FILTERS)
@pytest.mark.parametrize("gate", [None, 9.0])
@pytest.mark.parametrize("hole", [torch.nan, torch.inf])
def test_gradients_are_those_of_the_other_measurements(filtered: Any, gate: float | None, hole: float) -> None:
    state, z, r = problem()
    valid = torch.arange(ROWS).expand(2, ROWS) % 4 != 1
    root = torch.linalg.cholesky(state.covariance)

    def gradients(holes: Tensor, **options: Any) -> tuple[Tensor, ...]:
        inputs = tuple(x.clone().requires_grad_() for x in (state.mean, root, holes, r))
        mean, own_root, own_z, own_r = inputs
        got = filtered(Gaussian(mean, own_root @ own_root.mT), observe, own_z, own_r, gate=gate, **options)
        total = got.state.mean.sum() + got.state.covariance.square().sum() + got.nis.sum()
        return torch.autograd.grad(total, inputs)

    for mine, expected in zip(gradients(z.where(valid, hole)), gradients(z, valid=valid), strict=True):
        assert mine.isfinite().all()
        assert torch.allclose(mine, expected, rtol=0, atol=1e-11)


def test_an_estimate_without_a_finite_jacobian_is_stepped_back_from() -> None:
    """The first full step ends at 0, which has a lower cost but no derivative to go on from."""
    state = Gaussian(torch.tensor([1.0], dtype=torch.float64), torch.tensor([[1e4]], dtype=torch.float64))
    variance = torch.tensor([1e-2], dtype=torch.float64)

    def seen(x: Tensor) -> tuple[Tensor, Tensor]:
        return x, torch.where(x > 0.3, torch.ones_like(x), torch.nan).unsqueeze(-1)

    got = update_iterated(state, seen, Measurement(torch.zeros(1, dtype=torch.float64), variance)).update.state
    assert 0.3 < float(got.mean) < 0.5
    assert float(got.covariance) == pytest.approx(1e-2, rel=1e-3)
