"""On linear problems the unscented filter is the Kalman filter."""

import pytest
import torch

from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.motion import MotionModel
from torchhand.numerics.filters.sigma import UnscentedSettings
from torchhand.numerics.filters.unscented import predict, predict_linear, update

EXACT = [
    UnscentedSettings(),
    UnscentedSettings(alpha=1e-2),
    UnscentedSettings(beta=0.0, kappa=-2.0),
    UnscentedSettings(variant="kappa"),
    UnscentedSettings(variant="julier95"),
]


def kalman_update(
    state: Gaussian, matrix: torch.Tensor, measurement: torch.Tensor, variance: torch.Tensor, used: torch.Tensor
) -> tuple[Gaussian, torch.Tensor]:
    """Textbook update with the rows left out deleted, Joseph form; posterior and NIS."""
    rows, noise = matrix[used], variance[used].diag()
    innovation = measurement[used] - rows @ state.mean
    inverse = torch.linalg.inv(rows @ state.covariance @ rows.mT + noise)
    gain = state.covariance @ rows.mT @ inverse
    rest = torch.eye(len(state.mean), dtype=torch.float64) - gain @ rows
    covariance = rest @ state.covariance @ rest.mT + gain @ noise @ gain.mT
    return Gaussian(state.mean + gain @ innovation, covariance), innovation @ inverse @ innovation


@pytest.mark.parametrize("settings", EXACT, ids=str)
@pytest.mark.parametrize("dofs", [2, 9, 27])
def test_equals_the_kalman_filter_over_many_steps_with_missing_rows(dofs: int, settings: UnscentedSettings) -> None:
    generator = torch.Generator().manual_seed(dofs)
    model = MotionModel(order=2, acceleration_decay_s=0.3)
    step = model.transition(0.04, dofs)
    noise = model.process_noise(0.04, torch.rand(dofs, generator=generator, dtype=torch.float64) + 0.5)
    size, rows = model.state_size(dofs), 3 * dofs
    matrix = torch.randn(rows, dofs, generator=generator, dtype=torch.float64)
    full = torch.cat([matrix, torch.zeros(rows, size - dofs, dtype=torch.float64)], dim=-1)
    ours = theirs = Gaussian(torch.zeros(size, dtype=torch.float64), torch.eye(size, dtype=torch.float64))
    for index in range(25):
        measurement = torch.randn(rows, generator=generator, dtype=torch.float64)
        variance = torch.rand(rows, generator=generator, dtype=torch.float64) + 0.01
        used = torch.rand(rows, generator=generator) < (0.7 if index % 5 else 0.0)
        theirs = predict_linear(theirs, step, noise)
        theirs, nis = kalman_update(theirs, full, measurement, variance, used)
        ours = predict_linear(ours, step, noise) if index % 2 else predict(ours, lambda x: x @ step.mT, noise, settings)
        result = update(
            ours,
            lambda x: x[..., :dofs] @ matrix.mT,
            Measurement(measurement.where(used, torch.nan), variance, used),
            settings,
            observed=dofs if index % 3 else None,
        )
        ours = result.state
        tolerance = 1e-9 if settings.alpha == 1.0 else 1e-7
        assert torch.allclose(ours.mean, theirs.mean, rtol=0, atol=tolerance)
        assert torch.allclose(ours.covariance, theirs.covariance, rtol=0, atol=tolerance)
        assert float(result.nis) == pytest.approx(float(nis), rel=1e-7, abs=1e-9)
        assert int(result.count) == int(used.sum())


@pytest.mark.parametrize("settings", EXACT, ids=str)
def test_unscented_prediction_of_a_linear_model_is_exact(settings: UnscentedSettings) -> None:
    generator = torch.Generator().manual_seed(1)
    root = torch.randn(2, 3, 6, 6, generator=generator, dtype=torch.float64)
    state = Gaussian(torch.randn(2, 3, 6, generator=generator, dtype=torch.float64), root @ root.mT)
    step = torch.randn(6, 6, generator=generator, dtype=torch.float64)
    noise = torch.eye(6, dtype=torch.float64)
    expected = predict_linear(state, step, noise)
    got = predict(state, lambda x: x @ step.mT, noise, settings)
    assert torch.allclose(expected.covariance, step @ root @ (step @ root).mT + noise, rtol=0, atol=1e-11)
    assert torch.allclose(got.mean, expected.mean, rtol=0, atol=1e-9)
    assert torch.allclose(got.covariance, expected.covariance, rtol=0, atol=1e-9)


def test_the_printed_set_predicts_too_little_covariance_and_gains_less() -> None:
    settings = UnscentedSettings(variant="paper")
    state = Gaussian(torch.zeros(3, dtype=torch.float64), torch.eye(3, dtype=torch.float64))
    ratio = 6 / 7
    predicted = predict(state, lambda x: 2 * x, torch.eye(3, dtype=torch.float64), settings)
    assert torch.allclose(predicted.covariance, (4 * ratio + 1) * state.covariance, rtol=0, atol=1e-14)
    measurement, variance = torch.tensor([[1.0], [0.5]], dtype=torch.float64)
    for observed in (None, 1):
        result = update(state, lambda x: x[..., :1], Measurement(measurement, variance), settings, observed=observed)
        gain = ratio / (ratio + 0.5)
        assert result.state.mean.tolist() == pytest.approx([gain, 0.0, 0.0], abs=1e-14)
        assert result.state.covariance.diagonal().tolist() == pytest.approx([1 - gain * ratio, 1.0, 1.0], abs=1e-14)


def test_correlated_but_unobserved_states_move_too() -> None:
    covariance = torch.tensor([[1.0, 0.8], [0.8, 1.0]], dtype=torch.float64)
    state = Gaussian(torch.zeros(2, dtype=torch.float64), covariance)
    measurement, variance = torch.tensor([[1.0], [1.0]], dtype=torch.float64)
    result = update(state, lambda x: x, Measurement(measurement, variance), observed=1)
    assert result.state.mean.tolist() == pytest.approx([0.5, 0.4], abs=1e-15)
    assert result.state.covariance.flatten().tolist() == pytest.approx([0.5, 0.4, 0.4, 0.68], abs=1e-15)
