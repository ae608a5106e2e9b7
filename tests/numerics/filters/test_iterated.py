"""The iterated filter: the Kalman filter where the problem is linear, the mode of the posterior where it is not."""

import math
from typing import Any

import pytest
import scipy.optimize
import torch
from torch import Tensor

from tests.numerics.filters.linearised import linearised
from torchhand.numerics.filters.extended import update_extended
from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.iterated import IteratedSettings, update_iterated


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def spd(*shape: int, seed: int, floor: float = 0.1) -> Tensor:
    root = randn(*shape, shape[-1], seed=seed)
    return root @ root.mT + floor * torch.eye(shape[-1], dtype=torch.float64)


def close(got: Tensor, expected: Tensor, tolerance: float = 1e-10) -> None:
    assert got.shape == expected.shape
    assert torch.allclose(got, expected, rtol=0, atol=tolerance), float((got - expected).abs().max())


MIX = randn(9, 3, seed=42)


def curved(points: Tensor) -> Tensor:
    """Of the first three components, strongly curved within a prior of width 1."""
    seen = points[..., :3] @ MIX.mT
    return (0.7 * seen).sin() + 0.2 * seen.square()


OBSERVE = linearised(curved)


def problem(*batch: int, seed: int = 5) -> tuple[Gaussian, Tensor, Tensor]:
    state = Gaussian(randn(*batch, 4, seed=seed), 0.2 * spd(*batch, 4, seed=seed + 1))
    truth = state.mean + (torch.linalg.cholesky(state.covariance) @ randn(*batch, 4, 1, seed=seed + 2))[..., 0]
    return state, curved(truth) + 0.1 * randn(*batch, 9, seed=seed + 3), torch.full((*batch, 9), 0.01).double()


@pytest.mark.parametrize("is_full", [False, True])
@pytest.mark.parametrize("observed", [None, 3])
def test_on_a_linear_problem_it_is_the_kalman_filter(is_full: bool, observed: int | None) -> None:
    state, rows = Gaussian(randn(5, seed=1), spd(5, seed=2)), randn(7, observed or 5, seed=3)
    noise = spd(7, seed=4) if is_full else randn(7, seed=4).square() + 0.1
    valid = torch.tensor([True, True, False, True, True, True, False])
    measurement = randn(7, seed=5).where(valid, torch.nan)
    columns = rows.shape[1]
    expected = update_extended(state, measurement - rows @ state.mean[:columns], rows, noise, valid=valid)
    got = update_iterated(
        state, lambda x: (x @ rows.mT, rows), Measurement(measurement, noise, valid), observed=observed
    )
    close(got.update.state.mean, expected.state.mean)
    close(got.update.state.covariance, expected.state.covariance)
    close(got.update.nis, expected.nis, 1e-9)
    close(got.update.innovation_variance[valid], expected.innovation_variance[valid])
    assert int(got.iterations) == 1
    assert bool(got.is_converged)


def test_it_ends_at_the_mode_that_scipy_finds_and_one_step_does_not() -> None:
    state, measurement, variance = problem(6)
    root = torch.linalg.cholesky(state.covariance)
    got = update_iterated(
        state, OBSERVE, Measurement(measurement, variance), IteratedSettings(iterations=40, tolerance=1e-9)
    )
    value, jacobian = OBSERVE(state.mean)
    single = update_extended(state, measurement - value, jacobian, variance).state.mean
    assert got.is_converged.all()
    improved = 0
    for i in range(6):

        def cost_terms(x: Any, i: int = i) -> Any:
            x = torch.from_numpy(x)
            prior = torch.linalg.solve_triangular(root[i], (x - state.mean[i])[:, None], upper=False)[:, 0]
            return torch.cat((prior, (measurement[i] - curved(x)) / variance[i].sqrt())).numpy()

        peer: Any = scipy.optimize.least_squares(cost_terms, got.update.state.mean[i].numpy(), xtol=1e-14, ftol=1e-14)
        close(got.update.state.mean[i], torch.from_numpy(peer.x), 1e-6)
        assert float(got.update.nis[i]) == pytest.approx(2 * peer.cost, rel=1e-9)
        expected = torch.linalg.inv(torch.from_numpy(peer.jac.T @ peer.jac))  # of the residuals at the mode
        close(got.update.state.covariance[i], expected, 1e-6)
        improved += float((cost_terms(single[i].numpy()) ** 2).sum()) > 2 * peer.cost + 1.0
    assert improved >= 3  # the plain extended filter stays clearly above the mode


def test_one_iteration_moves_to_the_extended_filters_mean() -> None:
    state, measurement, variance = problem()
    state = Gaussian(state.mean, 1e-4 * state.covariance)
    measurement = curved(state.mean) + 1e-3 * randn(9, seed=1)
    value, jacobian = OBSERVE(state.mean)
    expected = update_extended(state, measurement - value, jacobian, variance).state.mean
    got = update_iterated(state, OBSERVE, Measurement(measurement, variance), IteratedSettings(iterations=1))
    close(got.update.state.mean, expected, 1e-14)
    assert int(got.iterations) == 1


def test_steps_that_overshoot_are_halved() -> None:
    """Gauss-Newton on atan diverges from beyond 1.39; halved steps come home."""
    state = Gaussian(torch.tensor([3.0], dtype=torch.float64), torch.tensor([[1e6]], dtype=torch.float64))
    zero, variance = torch.zeros(1, dtype=torch.float64), torch.tensor([1e-4], dtype=torch.float64)
    settings = IteratedSettings(iterations=30)
    got = update_iterated(state, linearised(torch.atan), Measurement(zero, variance), settings)
    assert bool(got.is_converged)
    assert abs(float(got.update.state.mean)) < 1e-5
    stuck = update_iterated(state, linearised(torch.atan), Measurement(zero, variance), IteratedSettings(halvings=0))
    assert not bool(stuck.is_converged)
    assert int(stuck.iterations) == 0
    assert float(stuck.update.state.mean) == 3.0  # the best estimate there was


def test_an_estimate_that_cannot_be_observed_is_stepped_back_from() -> None:
    """log x is NaN below 0, where the first full step ends."""
    state = Gaussian(torch.tensor([3.0], dtype=torch.float64), torch.tensor([[4.0]], dtype=torch.float64))
    measurement = torch.tensor([-1.0], dtype=torch.float64)
    variance = torch.tensor([1e-4], dtype=torch.float64)
    got = update_iterated(
        state, linearised(torch.log), Measurement(measurement, variance), IteratedSettings(iterations=30)
    )
    assert bool(got.is_converged)
    assert float(got.update.state.mean) == pytest.approx(math.exp(-1.0), abs=1e-3)


def test_angles_are_met_across_the_end_of_their_period() -> None:
    """A line at 89°, measured at -89°: two degrees away, not 178."""
    state = Gaussian(torch.tensor([89.0], dtype=torch.float64).deg2rad(), torch.tensor([[0.01]], dtype=torch.float64))
    measurement = torch.tensor([-89.0], dtype=torch.float64).deg2rad()
    period, variance = torch.tensor([math.pi], dtype=torch.float64), torch.tensor([0.01], dtype=torch.float64)

    def observe(x: Tensor) -> tuple[Tensor, Tensor]:
        return torch.remainder(x + math.pi / 2, math.pi) - math.pi / 2, torch.ones(1, 1, dtype=torch.float64)

    got = update_iterated(state, observe, Measurement(measurement, variance), period=period, gate=9.0)
    assert float(got.update.innovation.rad2deg()) == pytest.approx(2.0, abs=1e-9)
    assert float(got.update.state.mean.rad2deg()) == pytest.approx(90.0, abs=1e-9)
    without = update_iterated(state, observe, Measurement(measurement, variance), gate=9.0)
    assert not without.update.used.any()


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_a_batch_is_a_loop(batch: tuple[int, ...]) -> None:
    state, measurement, variance = problem(*batch, seed=20)
    valid = randn(*batch, 9, seed=30) > -1
    options: dict[str, Any] = {"gate": 60.0, "group": 3}
    got = update_iterated(state, OBSERVE, Measurement(measurement, variance, valid), **options)
    flat = [x.reshape(-1, *x.shape[len(batch) :]) for x in (state.mean, state.covariance, measurement, variance, valid)]
    ones = [
        update_iterated(Gaussian(x, p), OBSERVE, Measurement(z, r, v), **options)
        for x, p, z, r, v in zip(*flat, strict=True)
    ]
    for pick in (
        lambda u: u.update.state.mean,
        lambda u: u.update.state.covariance,
        lambda u: u.update.nis,
        lambda u: u.iterations.double(),
        lambda u: u.is_converged.double(),
    ):
        close(pick(got), torch.stack([pick(one) for one in ones]).reshape(pick(got).shape), 1e-9)


def test_asked_seldom_it_ends_where_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turns after the last one that moves anything, which an accelerator takes, move nothing."""
    prior, value, noise = problem(3)
    expected = update_iterated(prior, linearised(curved), Measurement(value, noise), IteratedSettings())
    asked = []
    monkeypatch.setattr(
        "torchhand.numerics.filters.iterated.asks_after", lambda turn, device: asked.append(turn) is not None
    )
    found = update_iterated(prior, linearised(curved), Measurement(value, noise), IteratedSettings())
    assert len(asked) > IteratedSettings().iterations  # to the end of all turns
    close(found.update.state.mean, expected.update.state.mean, 1e-12)
    close(found.update.state.covariance, expected.update.state.covariance, 1e-12)
    assert torch.equal(found.iterations, expected.iterations)


def test_nothing_to_use_changes_nothing() -> None:
    state, measurement, variance = problem(2)
    valid = torch.zeros(2, 9, dtype=torch.bool)
    got = update_iterated(state, OBSERVE, Measurement(measurement * torch.nan, variance * torch.nan, valid))
    assert torch.equal(got.update.state.mean, state.mean)
    assert torch.equal(got.update.state.covariance, state.covariance)
    assert got.is_converged.all()


def test_errors_are_named() -> None:
    wrong: dict[str, Any] = {"iterations": 0, "tolerance": 0.0, "halvings": -1}
    for name, value in wrong.items():
        with pytest.raises(ValueError, match=rf"iterated\.{name}: expected .* got {value}"):
            IteratedSettings(**{name: value})
    state, measurement, variance = problem()
    with pytest.raises(ValueError, match="observed must be None or 1 to 4, got 5"):
        update_iterated(state, OBSERVE, Measurement(measurement, variance), observed=5)
    with pytest.raises(ValueError, match=r"observe must return values \(8,\), got \(9,\)"):
        update_iterated(state, OBSERVE, Measurement(measurement[:8], variance[:8]))
    with pytest.raises(ValueError, match="period must be above 0, infinite where a measurement does not repeat"):
        update_iterated(state, OBSERVE, Measurement(measurement, variance), period=torch.zeros_like(variance))
