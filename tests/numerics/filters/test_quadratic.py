"""Observations as a quadratic cost: against the extended filter, batches, and what tells nothing."""

import pytest
import torch
from torch import Tensor

from torchhand.numerics.filters import Gaussian, update_extended, update_quadratic


def _given(batch: tuple[int, ...] = (), rank: int = 3) -> tuple[Gaussian, Tensor, Tensor]:
    """A belief of six numbers, and rows of so many measurements of the first four."""
    generator = torch.Generator().manual_seed(rank)
    root = torch.randn(*batch, 6, 6, generator=generator, dtype=torch.float64)
    mean = torch.randn(*batch, 6, generator=generator, dtype=torch.float64)
    rows = torch.randn(*batch, rank, 4, generator=generator, dtype=torch.float64)
    innovation = torch.randn(*batch, rank, generator=generator, dtype=torch.float64)
    return Gaussian(mean, root @ root.mT + 0.1 * torch.eye(6, dtype=torch.float64)), rows, innovation


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
@pytest.mark.parametrize("rank", [1, 4, 9])
def test_equals_the_extended_filter_with_a_root_of_the_matrix(rank: int, batch: tuple[int, ...]) -> None:
    state, rows, innovation = _given(batch, rank)
    expected = update_extended(state, innovation, rows, torch.ones_like(innovation)).state
    gradient = -(rows.mT @ innovation.unsqueeze(-1)).squeeze(-1)
    got = update_quadratic(state, gradient, rows.mT @ rows)
    torch.testing.assert_close(got.mean, expected.mean, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(got.covariance, expected.covariance, rtol=1e-9, atol=1e-9)


def test_the_mean_is_where_prior_and_cost_are_least_together() -> None:
    state, rows, innovation = _given()
    matrix, gradient = rows.mT @ rows, -(rows.mT @ innovation)
    whole = torch.linalg.inv(state.covariance)
    whole[:4, :4] += matrix
    step = -torch.linalg.solve(whole, torch.nn.functional.pad(gradient, (0, 2)))
    got = update_quadratic(state, gradient, matrix)
    torch.testing.assert_close(got.mean, state.mean + step, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(got.covariance, torch.linalg.inv(whole), rtol=1e-9, atol=1e-9)


def test_numbers_that_are_not_finite_change_nothing_and_no_other_filter() -> None:
    state, rows, innovation = _given((2,))
    gradient, matrix = -(rows.mT @ innovation.unsqueeze(-1)).squeeze(-1), rows.mT @ rows
    broken = gradient.clone()
    broken[0, 1] = torch.nan
    got, expected = update_quadratic(state, broken, matrix), update_quadratic(state, gradient, matrix)
    torch.testing.assert_close(got.mean[0], state.mean[0], rtol=0, atol=1e-12)
    torch.testing.assert_close(got.covariance[0], state.covariance[0], rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(got.mean[1], expected.mean[1], rtol=1e-12, atol=1e-12)


def test_a_precise_observation_leaves_a_positive_covariance() -> None:
    state, rows, innovation = _given(rank=4)
    got = update_quadratic(state, -1e12 * (rows.mT @ innovation), 1e12 * rows.mT @ rows)
    assert float(torch.linalg.eigvalsh(got.covariance).min()) > -1e-12
    torch.testing.assert_close((rows @ (got.mean - state.mean)[:4]), innovation, rtol=0, atol=1e-6)
