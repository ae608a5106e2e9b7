"""The likeliest state of a Gaussian in a box, against scipy's bounded optimiser."""

import numpy as np
import pytest
import torch
from scipy.optimize import lsq_linear

from tests.device_guard import no_host_reads
from torchhand import devices
from torchhand.numerics.box import mode_in_box
from torchhand.numerics.filters import Gaussian


def _gaussian(seed: int, n: int = 6, batch: tuple[int, ...] = ()) -> Gaussian:
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(*batch, n, n, generator=generator, dtype=torch.float64)
    mean = torch.randn(*batch, n, generator=generator, dtype=torch.float64)
    return Gaussian(mean, root @ root.mT + 0.05 * torch.eye(n, dtype=torch.float64))


@pytest.mark.parametrize("seed", range(12))
def test_the_mode_is_that_of_a_bounded_optimiser(seed: int) -> None:
    state = _gaussian(seed)
    lower, upper = torch.full((6,), -0.4, dtype=torch.float64), torch.full((6,), 0.3, dtype=torch.float64)
    lower[0], upper[1] = -torch.inf, torch.inf
    value, is_bound = mode_in_box(state, lower, upper)
    whitened = torch.linalg.inv(torch.linalg.cholesky(state.covariance)).numpy()
    expected = lsq_linear(
        whitened, whitened @ state.mean.numpy(), (lower.numpy(), upper.numpy()), method="bvls", tol=1e-14
    ).x
    np.testing.assert_allclose(value.numpy(), expected, atol=1e-9)
    assert torch.equal(is_bound, (value == lower) | (value == upper))


def test_correlated_variables_follow_and_others_stay() -> None:
    mean = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    covariance = torch.tensor([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    bound = torch.tensor([0.2, torch.inf, torch.inf], dtype=torch.float64)
    value, is_bound = mode_in_box(Gaussian(mean, covariance), -bound, bound)
    torch.testing.assert_close(value, mean.new_tensor([0.2, -0.4, 0.0]), atol=1e-15, rtol=0)
    assert is_bound.tolist() == [True, False, False]


def test_a_mean_inside_stays_as_it_is() -> None:
    state = _gaussian(3)
    bound = torch.full((6,), 10.0, dtype=torch.float64)
    value, is_bound = mode_in_box(state, -bound, bound)
    assert torch.equal(value, state.mean)
    assert not bool(is_bound.any())


@pytest.mark.parametrize("batch", [(1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...]) -> None:
    state = _gaussian(5, batch=batch)
    bound = torch.full((6,), 0.3, dtype=torch.float64)
    values, is_bound = mode_in_box(state, -bound, bound)
    means, covariances = state.mean.reshape(-1, 6), state.covariance.reshape(-1, 6, 6)
    for i, (mean, covariance) in enumerate(zip(means, covariances, strict=True)):
        value, on = mode_in_box(Gaussian(mean, covariance), -bound, bound)
        torch.testing.assert_close(values.reshape(-1, 6)[i], value, atol=1e-12, rtol=0)
        assert torch.equal(is_bound.reshape(-1, 6)[i], on)


def test_the_mode_is_the_same_where_it_is_asked_seldom_whether_it_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    state = _gaussian(3, batch=(20,))
    bounds = torch.full((6,), -0.4, dtype=torch.float64), torch.full((6,), 0.3, dtype=torch.float64)
    expected = mode_in_box(state, *bounds)
    monkeypatch.setattr(devices, "_HOSTS", ())
    found = mode_in_box(state, *bounds)
    torch.testing.assert_close(found[0], expected[0], rtol=1e-12, atol=1e-12)
    assert torch.equal(found[1], expected[1])


def test_no_turn_waits_for_its_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the processor treated as an accelerator: it is asked at the stride alone, and finds the same."""
    state = _gaussian(5)
    bound = torch.full((6,), 0.3, dtype=torch.float64)
    expected, is_expected = mode_in_box(state, -bound, bound)
    assert bool(is_expected.any())
    monkeypatch.setattr(devices, "_HOSTS", ())
    with no_host_reads() as permitted:
        value, is_bound = mode_in_box(state, -bound, bound)
    assert 0 < permitted.count <= 2 * 3 * 6 // devices.TURNS
    torch.testing.assert_close(value, expected, atol=1e-12, rtol=0)
    assert torch.equal(is_bound, is_expected)
