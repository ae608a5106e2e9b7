"""The unscented filter on nonlinear problems: against filterpy and against its own plain forms."""

from typing import Any

import filterpy.kalman
import pytest
import torch

from torchhand.numerics.filters.consistency import nis
from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.sigma import UnscentedSettings, sigma_points
from torchhand.numerics.filters.unscented import predict, update

SIZE, SEEN, ROWS = 6, 4, 20
ALL = [
    UnscentedSettings(),
    UnscentedSettings(alpha=1e-2),
    UnscentedSettings(alpha=0.5, beta=0.0),
    UnscentedSettings(beta=0.0, kappa=-1.0),
    UnscentedSettings(variant="kappa"),
    UnscentedSettings(variant="julier95"),
    UnscentedSettings(variant="paper"),
]


def randn(*shape: int, seed: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def random_state(*batch: int, seed: int = 0, scale: float = 0.3) -> Gaussian:
    root = randn(*batch, SIZE, SIZE, seed=seed) * scale
    return Gaussian(randn(*batch, SIZE, seed=seed + 1), root @ root.mT + 0.01 * torch.eye(SIZE, dtype=torch.float64))


MIX = randn(ROWS, SEEN, seed=42)


def observe(points: torch.Tensor) -> torch.Tensor:
    """Strongly curved, of the first SEEN components only."""
    angles = points[..., :SEEN] @ MIX.mT
    return angles.sin() + 0.3 * angles.square()


def transition(points: torch.Tensor) -> torch.Tensor:
    return points + 0.1 * points.roll(1, -1).sin() * points


def random_problem(*batch: int, seed: int = 7) -> tuple[Gaussian, torch.Tensor, torch.Tensor]:
    state = random_state(*batch, seed=seed)
    measurement = observe(state.mean) + 0.5 * randn(*batch, ROWS, seed=seed + 2)
    return state, measurement, 0.05 + randn(*batch, ROWS, seed=seed + 3).square()


def dense_update(
    state: Gaussian, settings: UnscentedSettings, measurement: torch.Tensor, variance: torch.Tensor, used: torch.Tensor
) -> tuple[Gaussian, torch.Tensor, torch.Tensor]:
    """The specification: all points, weighted sums, the inverse of S, rows left out deleted."""
    points, mean_weights, covariance_weights = sigma_points(state, settings)
    values = observe(points)
    predicted = mean_weights @ values
    deviation = values - predicted
    full = (deviation.mT * covariance_weights) @ deviation + variance.diag()
    innovation = (measurement - predicted)[used]
    cross = ((points - state.mean).mT * covariance_weights) @ deviation[:, used]
    inverse = torch.linalg.inv(full[used][:, used])
    gain = cross @ inverse
    posterior = Gaussian(state.mean + gain @ innovation, state.covariance - gain @ cross.mT)
    return posterior, full.diagonal(), innovation @ inverse @ innovation


@pytest.mark.parametrize("settings", ALL, ids=str)
@pytest.mark.parametrize("observed", [None, SEEN])
def test_information_form_equals_the_dense_form_with_rows_deleted(
    settings: UnscentedSettings, observed: int | None
) -> None:
    state, measurement, variance = random_problem()
    used = torch.arange(ROWS) % 4 != 1
    expected, diagonal, expected_nis = dense_update(state, settings, measurement, variance, used)
    got = update(
        state,
        observe,
        Measurement(measurement.where(used, torch.nan), variance.where(used, torch.nan), used),
        settings,
        observed=observed,
    )
    tolerance = 1e-10 if settings.alpha == 1.0 else 1e-8  # the dense form cancels for small alpha
    assert torch.allclose(got.state.mean, expected.mean, rtol=0, atol=tolerance)
    assert torch.allclose(got.state.covariance, expected.covariance, rtol=0, atol=tolerance)
    assert torch.allclose(got.innovation_variance[used], diagonal[used], rtol=tolerance, atol=0)
    assert float(got.nis) == pytest.approx(float(expected_nis), rel=1e-7)
    assert torch.equal(got.used, used)
    assert (got.innovation[~used] == 0).all()
    assert got.innovation_variance[~used].isinf().all()


@pytest.mark.parametrize("settings", ALL, ids=str)
@pytest.mark.parametrize("observed", [1, SEEN, SIZE])
def test_observing_only_the_first_components_equals_the_full_evaluation(
    settings: UnscentedSettings, observed: int
) -> None:
    state, measurement, variance = random_problem(2, 3)
    calls = []

    def observe_first(points: torch.Tensor) -> torch.Tensor:
        calls.append(tuple(points.shape))
        angles = points[..., :observed] @ MIX[:, : min(observed, SEEN)].mT if observed < SEEN else None
        return observe(points) if angles is None else angles.sin() + 0.3 * angles.square()

    full = update(state, observe_first, Measurement(measurement, variance), settings, gate=4.0)
    short = update(state, observe_first, Measurement(measurement, variance), settings, gate=4.0, observed=observed)
    assert calls == [(2, 3, 2 * SIZE + 1, SIZE), (2, 3, 2 * observed + 1, observed)]
    tolerance = 1e-12 if settings.alpha == 1.0 else 1e-9
    assert torch.allclose(short.state.mean, full.state.mean, rtol=0, atol=tolerance)
    assert torch.allclose(short.state.covariance, full.state.covariance, rtol=0, atol=tolerance)
    assert torch.allclose(short.innovation_variance, full.innovation_variance, rtol=1e-9, atol=0)
    assert torch.allclose(short.nis, full.nis, rtol=1e-9, atol=0)


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        (filterpy.kalman.MerweScaledSigmaPoints(SIZE, 1.0, 2.0, 0.0), UnscentedSettings()),
        (filterpy.kalman.MerweScaledSigmaPoints(SIZE, 0.5, 2.0, 1.0), UnscentedSettings(alpha=0.5, kappa=1.0)),
        (filterpy.kalman.JulierSigmaPoints(SIZE, 0.5), UnscentedSettings(variant="kappa")),
        (filterpy.kalman.JulierSigmaPoints(SIZE, 0.0), UnscentedSettings(variant="julier95")),
        (filterpy.kalman.JulierSigmaPoints(SIZE, -1.0), UnscentedSettings(beta=0.0, kappa=-1.0)),
    ],
    ids=["merwe", "merwe_narrow", "kappa", "julier95", "julier_negative"],
)
@pytest.mark.parametrize("is_redrawn", [True, False])
def test_equals_filterpy_on_a_nonlinear_problem(theirs: Any, ours: UnscentedSettings, is_redrawn: bool) -> None:
    noise = 0.02 * torch.eye(SIZE, dtype=torch.float64)
    state = random_state(scale=0.1)
    peer = filterpy.kalman.UnscentedKalmanFilter(
        SIZE,
        ROWS,
        1.0,
        hx=lambda x: observe(torch.from_numpy(x)).numpy(),
        fx=lambda x, dt: transition(torch.from_numpy(x)).numpy(),
        points=theirs,
    )
    peer.x, peer.P, peer.Q = state.mean.numpy().copy(), state.covariance.numpy().copy(), noise.numpy()
    truth = state.mean
    for index in range(4):
        points = transition(sigma_points(state, ours).points)
        state = predict(state, transition, noise, ours)
        peer.predict()
        assert torch.allclose(state.mean, torch.from_numpy(peer.x), rtol=0, atol=1e-9)
        assert torch.allclose(state.covariance, torch.from_numpy(peer.P), rtol=0, atol=1e-9)
        # Some versions of filterpy draw new points after a prediction, some keep the moved ones.
        peer.sigmas_f = peer.points_fn.sigma_points(peer.x, peer.P) if is_redrawn else points.numpy()
        truth = transition(truth)
        measurement = observe(truth) + 0.3 * randn(ROWS, seed=100 + index)
        variance = 0.05 + randn(ROWS, seed=200 + index).square()
        peer.update(measurement.numpy(), R=variance.diag().numpy())
        result = update(state, observe, Measurement(measurement, variance), ours, points=None if is_redrawn else points)
        state = result.state
        assert torch.allclose(state.mean, torch.from_numpy(peer.x), rtol=0, atol=1e-9)
        assert torch.allclose(state.covariance, torch.from_numpy(peer.P), rtol=0, atol=1e-9)
        assert torch.allclose(result.innovation_variance, torch.from_numpy(peer.S).diagonal(), rtol=1e-9, atol=0)
        full_nis = nis(result.innovation, torch.from_numpy(peer.S))
        assert float(result.nis) == pytest.approx(float(full_nis), rel=1e-8)


@pytest.mark.parametrize("settings", ALL, ids=str)
@pytest.mark.parametrize("batch", [(1,), (2, 3)])
def test_a_batch_equals_a_loop(settings: UnscentedSettings, batch: tuple[int, ...]) -> None:
    state, measurement, variance = random_problem(*batch)
    valid = randn(*batch, ROWS, seed=9) > -0.5
    valid.view(-1, ROWS)[-1] = False  # the last filter sees nothing
    noise = 0.01 * torch.eye(SIZE, dtype=torch.float64)
    moved = predict(state, transition, noise, settings)
    together = update(moved, observe, Measurement(measurement, variance, valid), settings, gate=9.0)
    for index in torch.cartesian_prod(*(torch.arange(n) for n in batch)).reshape(-1, len(batch)).tolist():
        at = tuple(index)
        one = predict(Gaussian(state.mean[at], state.covariance[at]), transition, noise, settings)
        alone = update(one, observe, Measurement(measurement[at], variance[at], valid[at]), settings, gate=9.0)
        tolerance = 1e-12 if settings.alpha == 1.0 else 1e-9
        assert torch.allclose(together.state.mean[at], alone.state.mean, rtol=0, atol=tolerance)
        assert torch.allclose(together.state.covariance[at], alone.state.covariance, rtol=0, atol=tolerance)
        assert torch.allclose(together.nis[at], alone.nis, rtol=1e-9, atol=1e-12)
        assert torch.equal(together.used[at], alone.used)
        assert torch.equal(together.count[at], alone.count)


def test_gating_equals_deleting_the_outliers() -> None:
    state, measurement, variance = random_problem()
    measurement[3] += 40.0
    measurement[11] -= 60.0
    gated = update(state, observe, Measurement(measurement, variance), gate=9.0)
    assert (~gated.used).nonzero().flatten().tolist() == [3, 11]
    assert int(gated.count) == ROWS - 2
    assert float(gated.innovation[3]) > 20
    expected = update(state, observe, Measurement(measurement, variance, gated.used))
    assert torch.allclose(gated.state.mean, expected.state.mean, rtol=0, atol=1e-13)
    assert torch.allclose(gated.state.covariance, expected.state.covariance, rtol=0, atol=1e-13)
    assert torch.allclose(gated.nis, expected.nis, rtol=1e-12, atol=0)


def test_the_gate_is_measured_in_standard_deviations_of_the_innovation() -> None:
    state = Gaussian(torch.zeros(4, dtype=torch.float64), 3.0 * torch.eye(4, dtype=torch.float64))
    measurement = torch.tensor([5.9, 6.1, -5.9, -6.1], dtype=torch.float64)  # S = 3 + 1, three sigma = 6
    result = update(state, lambda x: x, Measurement(measurement, torch.ones(4, dtype=torch.float64)), gate=9.0)
    assert result.used.tolist() == [True, False, True, False]


def test_nan_predicted_in_hidden_rows_has_no_effect() -> None:
    state, measurement, variance = random_problem()
    valid = torch.arange(ROWS) % 5 != 0
    mean = state.mean.clone().requires_grad_()

    def observe_some(points: torch.Tensor) -> torch.Tensor:
        return observe(points).where(valid, torch.nan)

    result = update(Gaussian(mean, state.covariance), observe_some, Measurement(measurement, variance, valid))
    expected = update(state, observe, Measurement(measurement, variance, valid))
    assert torch.equal(result.state.mean, expected.state.mean)
    assert torch.equal(result.state.covariance, expected.state.covariance)
    (gradient,) = torch.autograd.grad(result.state.mean.sum() + result.nis, mean)
    assert gradient.isfinite().all()


@pytest.mark.parametrize("settings", ALL, ids=str)
def test_without_measurements_nothing_changes(settings: UnscentedSettings) -> None:
    state, measurement, variance = random_problem(2)
    hidden = update(
        state,
        observe,
        Measurement(measurement * torch.nan, variance * 0, torch.zeros(2, ROWS, dtype=torch.bool)),
        settings,
    )
    empty = update(
        state, lambda x: x[..., :0], Measurement(measurement[..., :0], variance[..., :0]), settings, observed=SEEN
    )
    gated = update(state, observe, Measurement(measurement + 1e3, variance), settings, gate=1.0)
    for result in (hidden, empty, gated):
        assert torch.equal(result.state.mean, state.mean)
        assert torch.equal(result.state.covariance, state.covariance)
        assert result.nis.tolist() == [0.0, 0.0]
        assert result.count.tolist() == [0, 0]


def test_gradients_are_right_and_nan_in_hidden_rows_stays_out() -> None:
    valid = torch.arange(ROWS) % 5 != 0

    def posterior(root: torch.Tensor, mean: torch.Tensor, z: torch.Tensor, r: torch.Tensor) -> tuple[torch.Tensor, ...]:
        state = Gaussian(mean, root @ root.mT)
        result = update(state, observe, Measurement(z.where(valid, torch.nan), r, valid), observed=SEEN)
        return result.state.mean, result.state.covariance, result.nis

    state, measurement, variance = random_problem()
    inputs = (torch.linalg.cholesky(state.covariance), state.mean, measurement, variance)
    inputs = tuple(value.clone().requires_grad_() for value in inputs)
    assert torch.autograd.gradcheck(posterior, inputs, fast_mode=True)


def test_float32_stays_positive_definite_in_a_long_run() -> None:
    state = Gaussian(torch.zeros(SIZE), torch.eye(SIZE))
    noise = 1e-3 * torch.eye(SIZE)
    mix = MIX.float()
    for index in range(100):
        state = predict(state, lambda x: 0.99 * x, noise)
        measurement = 0.01 * randn(ROWS, seed=index).float()
        result = update(
            state, lambda x: (x[..., :SEEN] @ mix.mT).sin(), Measurement(measurement, torch.full((ROWS,), 1e-6))
        )
        state = result.state
    assert state.mean.dtype == torch.float32
    assert float(torch.linalg.eigvalsh(state.covariance)[0]) > 0
    assert state.mean[:SEEN].abs().max() < 0.05


def test_errors_are_named() -> None:
    state, measurement, variance = random_problem()
    with pytest.raises(ValueError, match=r"variance must be above 0"):
        update(state, observe, Measurement(measurement, variance * 0))
    with pytest.raises(ValueError, match=r"noise: expected variances .*, got covariances \(20, 20\)"):
        update(state, observe, Measurement(measurement, variance.diag()))
    with pytest.raises(ValueError, match=r"noise: expected torch.float64, that of the value, got torch.float32"):
        Measurement(measurement, variance.float())
    with pytest.raises(ValueError, match=r"gate must be None or above 0, got -1"):
        update(state, observe, Measurement(measurement, variance), gate=-1.0)
    with pytest.raises(ValueError, match=r"observed must be None or 1 to 6, got 7"):
        update(state, observe, Measurement(measurement, variance), observed=7)
    with pytest.raises(ValueError, match=r"observe must return shape \(13, 20\), got \(13, 19\)"):
        update(state, lambda x: observe(x)[..., :-1], Measurement(measurement, variance))
    with pytest.raises(ValueError, match=r"transition must return shape \(13, 6\), got \(13, 5\)"):
        predict(state, lambda x: x[..., :-1], torch.eye(SIZE, dtype=torch.float64))
    points = sigma_points(state, UnscentedSettings()).points
    with pytest.raises(ValueError, match="got both observed and points"):
        update(state, observe, Measurement(measurement, variance), points=points, observed=2)
    with pytest.raises(ValueError, match="points must be 13 for a state of 6 numbers, got 12"):
        update(state, observe, Measurement(measurement, variance), points=points[:-1])


def test_a_centre_that_would_leave_no_covariance_is_left_out() -> None:
    """Of far too little spread in too many dimensions: with it the innovation would have a variance below zero."""
    settings = UnscentedSettings(beta=0.0, kappa=-5.5)
    state = Gaussian(torch.zeros(6, dtype=torch.float64), torch.eye(6, dtype=torch.float64))
    variance = torch.full((1,), 1e-6, dtype=torch.float64)

    def squared(points: torch.Tensor) -> torch.Tensor:
        return points.square().sum(-1, keepdim=True)

    got = update(state, squared, Measurement(torch.full((1,), 5.0, dtype=torch.float64), variance), settings)
    assert float(got.innovation_variance) > 0
    assert float(got.nis) >= 0
    assert float(torch.linalg.eigvalsh(got.state.covariance)[0]) > -1e-12


def test_a_measurement_whose_square_overflows_is_a_missing_one() -> None:
    state, measurement, variance = random_problem()
    used = torch.arange(ROWS) % 4 != 1
    expected = update(state, observe, Measurement(measurement, variance, used))
    far = torch.finfo(torch.float64).max / 4
    got = update(state, observe, Measurement(measurement.where(used, far), variance))
    assert torch.equal(got.used, used)
    assert torch.equal(got.state.mean, expected.state.mean)
    assert torch.equal(got.state.covariance, expected.state.covariance)
    assert torch.equal(got.nis, expected.nis)
