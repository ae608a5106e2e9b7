"""The extended filter: the Kalman filter on linear problems; missing rows, gates, periods."""

import math
from collections.abc import Callable
from typing import Any

import filterpy.kalman
import pytest
import torch
from torch import Tensor

from tests.numerics.filters.linearised import linearised
from torchhand.numerics.filters.extended import update_extended
from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.motion import MotionModel
from torchhand.numerics.filters.unscented import predict_linear, update
from torchhand.numerics.filters.whitening import wrapped


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def spd(*shape: int, seed: int, floor: float = 0.1) -> Tensor:
    root = randn(*shape, shape[-1], seed=seed)
    return root @ root.mT + floor * torch.eye(shape[-1], dtype=torch.float64)


def close(got: Tensor, expected: Tensor, tolerance: float = 1e-10) -> None:
    assert got.shape == expected.shape
    assert torch.allclose(got, expected, rtol=0, atol=tolerance), float((got - expected).abs().max())


def kalman(state: Gaussian, innovation: Tensor, rows: Tensor, noise: Tensor) -> tuple[Gaussian, Tensor]:
    """The closed form P - K S Kᵀ with the inverse of S, and NIS."""
    rows = torch.nn.functional.pad(rows, (0, len(state.mean) - rows.shape[-1]))
    full = rows @ state.covariance @ rows.mT + noise
    gain = state.covariance @ rows.mT @ torch.linalg.inv(full)
    nis = innovation @ torch.linalg.inv(full) @ innovation
    return Gaussian(state.mean + gain @ innovation, state.covariance - gain @ full @ gain.mT), nis


@pytest.mark.parametrize("is_full", [False, True])
@pytest.mark.parametrize(("m", "k"), [(3, 6), (5, 4), (40, 4)])
def test_equals_the_closed_form_with_rows_deleted(is_full: bool, m: int, k: int) -> None:
    state = Gaussian(randn(6, seed=1), spd(6, seed=2))
    rows, innovation = randn(m, k, seed=3), randn(m, seed=4)
    noise = spd(m, seed=5) if is_full else randn(m, seed=5).square() + 0.1
    used = torch.arange(m) % 3 != 1
    dense = noise if is_full else noise.diag()
    expected, nis = kalman(state, innovation[used], rows[used], dense[used][:, used])
    holes = noise.where(used & used[:, None] if is_full else used, torch.nan)
    got = update_extended(
        state,
        innovation.where(used, torch.nan),
        rows.where(used[:, None], torch.nan),
        holes,
        valid=used,
    )
    close(got.state.mean, expected.mean)
    close(got.state.covariance, expected.covariance)
    close(got.nis, nis, 1e-9)
    assert int(got.count) == int(used.sum())
    padded = torch.nn.functional.pad(rows, (0, 6 - k))
    close(got.innovation_variance[used], (padded @ state.covariance @ padded.mT + dense).diagonal()[used])
    assert got.innovation_variance[~used].isinf().all()
    assert (got.innovation[~used] == 0).all()


def test_a_run_equals_filterpy_and_the_unscented_filter() -> None:
    dofs, m, dt_s = 3, 7, 0.04
    model, density = MotionModel(order=1, velocity_decay_s=0.5), torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)
    matrix, variance = randn(m, dofs, seed=1), randn(m, seed=2).square() + 0.05
    peer: Any = filterpy.kalman.KalmanFilter(dim_x=2 * dofs, dim_z=m)
    peer.F, peer.Q = model.transition(dt_s, dofs).numpy(), model.process_noise(dt_s, density).numpy()
    peer.H, peer.R = torch.cat((matrix, torch.zeros_like(matrix)), 1).numpy(), variance.diag().numpy()
    peer.P, peer.x = torch.eye(2 * dofs, dtype=torch.float64).numpy(), peer.x * 0.0
    ours = theirs = Gaussian(torch.zeros(2 * dofs, dtype=torch.float64), torch.eye(2 * dofs, dtype=torch.float64))
    for index in range(20):
        z = randn(m, seed=10 + index)
        peer.predict()
        peer.update(z.numpy())
        ours = predict_linear(ours, model.transition(dt_s, dofs), model.process_noise(dt_s, density))
        result = update_extended(ours, z - matrix @ ours.mean[:dofs], matrix, variance)
        ours = result.state
        theirs = predict_linear(theirs, model.transition(dt_s, dofs), model.process_noise(dt_s, density))
        theirs = update(theirs, lambda x: x @ matrix.mT, Measurement(z, variance), observed=dofs).state
        close(ours.mean, torch.from_numpy(peer.x[:, 0]))
        close(ours.covariance, torch.from_numpy(peer.P))
        close(ours.mean, theirs.mean)
        close(ours.covariance, theirs.covariance)
        expected_nis = peer.y[:, 0] @ peer.SI @ peer.y[:, 0]
        assert float(result.nis) == pytest.approx(float(expected_nis), rel=1e-8)


def polar(points: Tensor) -> Tensor:
    """Range and bearing of the first two components, and a curve of the third."""
    x, y, w = points[..., 0], points[..., 1], points[..., 2]
    return torch.stack(((x * x + y * y).sqrt(), torch.atan2(y, x), w.sin() + x * w), -1)


def test_a_nonlinear_step_equals_filterpys_extended_filter() -> None:
    state = Gaussian(torch.tensor([2.0, 1.0, 0.3], dtype=torch.float64), 0.1 * spd(3, seed=1))
    peer: Any = filterpy.kalman.ExtendedKalmanFilter(dim_x=3, dim_z=3)
    noise = 0.1 * spd(3, seed=2)
    peer.x, peer.P, peer.R = state.mean.numpy().copy(), state.covariance.numpy().copy(), noise.numpy()
    z = polar(state.mean) + 0.2 * randn(3, seed=3)
    both = linearised(polar)
    value, jacobian = both(state.mean)
    peer.update(z.numpy(), lambda x: both(torch.from_numpy(x))[1].numpy(), lambda x: polar(torch.from_numpy(x)).numpy())
    got = update_extended(state, z - value, jacobian, noise).state
    close(got.mean, torch.from_numpy(peer.x))
    close(got.covariance, torch.from_numpy(peer.P))


def test_jacobians_by_automatic_differentiation_are_those_of_the_function() -> None:
    states = randn(2, 3, 3, seed=1) + 3
    value, jacobian = linearised(polar)(states)
    close(value, polar(states), 1e-15)
    step = 1e-6
    for i in range(3):
        shift = step * torch.eye(3, dtype=torch.float64)[i]
        close(jacobian[..., i], (polar(states + shift) - polar(states - shift)) / (2 * step), 1e-8)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_a_batch_is_a_loop(batch: tuple[int, ...]) -> None:
    m, n, k = 8, 5, 3
    state = Gaussian(randn(*batch, n, seed=1), spd(*batch, n, seed=2))
    innovation, rows = 3 * randn(*batch, m, seed=3), randn(*batch, m, k, seed=4)
    noise, valid = spd(*batch, m, seed=5), randn(*batch, m, seed=6) > -0.8
    got = update_extended(state, innovation, rows, noise, valid=valid, gate=4.0, group=2)
    flat = [
        x.reshape(-1, *x.shape[len(batch) :]) for x in (state.mean, state.covariance, innovation, rows, noise, valid)
    ]
    ones = [
        update_extended(Gaussian(x, p), i, r, s, valid=v, gate=4.0, group=2)
        for x, p, i, r, s, v in zip(*flat, strict=True)
    ]
    for pick in (
        lambda u: u.state.mean,
        lambda u: u.state.covariance,
        lambda u: u.nis,
        lambda u: u.innovation_variance,
    ):
        close(pick(got), torch.stack([pick(one) for one in ones]).reshape(pick(got).shape), 1e-11)
    assert torch.equal(got.used, torch.stack([one.used for one in ones]).reshape(got.used.shape))
    shared = update_extended(state, innovation, randn(m, k, seed=4), noise.new_ones(*(1,) * len(batch), m))
    again = update_extended(state, innovation, randn(m, k, seed=4).expand(*batch, m, k), noise.new_ones(*batch, m))
    close(shared.state.mean, again.state.mean, 0)


def test_a_gate_drops_exactly_the_groups_beyond_it() -> None:
    state = Gaussian(torch.zeros(2, dtype=torch.float64), torch.eye(2, dtype=torch.float64))
    rows = torch.eye(2, dtype=torch.float64).repeat(2, 1)  # two groups that each see both components
    innovation = torch.tensor([1.0, 1.0, 2.5, 2.5], dtype=torch.float64)
    noise = torch.full((4,), 0.5, dtype=torch.float64)
    single = update_extended(state, innovation, rows, noise, gate=4.0)
    assert single.used.tolist() == [True, True, False, False]  # 6.25 / 1.5 = 4.17
    grouped = update_extended(state, innovation, rows, noise, gate=8.0, group=2)  # 2 · 4.17 = 8.33
    assert grouped.used.tolist() == [True, True, False, False]
    assert update_extended(state, innovation, rows, noise, gate=8.4, group=2).used.all()
    close(single.innovation, innovation)
    expected, nis = kalman(state, innovation[:2], rows[:2], noise[:2].diag())
    close(single.state.mean, expected.mean)
    close(single.nis, nis)
    # Correlated noise within a group: differences are what it may not have.
    block = torch.tensor([[1.0, 0.99], [0.99, 1.0]], dtype=torch.float64)
    tight = Gaussian(state.mean, 1e-6 * state.covariance)
    for values, kept in (((2.0, 2.0), True), ((1.0, -1.0), False)):
        pair = torch.tensor(values, dtype=torch.float64)
        got = update_extended(tight, pair, rows[:2], block, gate=9.0, group=2)
        assert got.used.tolist() == [kept, kept]


def test_nothing_to_use_changes_nothing() -> None:
    state = Gaussian(randn(2, 3, seed=1), spd(2, 3, seed=2))
    nothing = torch.full((2, 4), torch.nan, dtype=torch.float64)
    valid = torch.tensor([[False] * 4, [False, True, False, False]])
    rows = torch.full((2, 4, 3), torch.nan, dtype=torch.float64)
    rows[1, 1], nothing[1, 1] = 1.0, 0.5
    got = update_extended(state, nothing, rows, nothing.abs(), valid=valid)
    assert torch.equal(got.state.mean[0], state.mean[0])
    assert torch.equal(got.state.covariance[0], state.covariance[0])
    assert got.count.tolist() == [0, 1]
    assert float(got.nis[0]) == 0
    assert not torch.equal(got.state.mean[1], state.mean[1])


def test_covariance_stays_positive_where_numbers_are_extreme() -> None:
    """Prior and noise ten decades apart, float32: the short form P - K S Kᵀ goes negative here."""
    state = Gaussian(torch.zeros(4), 1e4 * torch.eye(4))
    rows = randn(12, 4, seed=1).float()
    noise = torch.full((12,), 1e-6)
    covariance = update_extended(state, torch.zeros(12), rows, noise).state.covariance
    assert torch.equal(covariance, covariance.mT)
    assert float(torch.linalg.eigvalsh(covariance.double()).min()) > 0
    gain = state.covariance @ rows.mT @ torch.linalg.inv(rows @ state.covariance @ rows.mT + noise.diag())
    short = (torch.eye(4) - gain @ rows) @ state.covariance
    assert float(torch.linalg.eigvalsh((short + short.mT).double()).min()) < 0


def test_a_prior_without_spread_in_some_direction_is_accepted() -> None:
    flat = torch.diag(torch.tensor([1.0, 0.0, 2.0], dtype=torch.float64))
    state, rows = Gaussian(torch.zeros(3, dtype=torch.float64), flat), randn(5, 3, seed=1)
    innovation, noise = randn(5, seed=2), torch.ones(5, dtype=torch.float64)
    expected, _ = kalman(state, innovation, rows, noise.diag())
    got = update_extended(state, innovation, rows, noise)
    close(got.state.mean, expected.mean, 1e-11)  # clipped at 1e-12 of the largest eigenvalue
    close(got.state.covariance, expected.covariance, 1e-11)


@pytest.mark.parametrize("is_full", [False, True])
def test_derivatives(is_full: bool) -> None:
    root, rows, innovation = spd(3, seed=1), randn(4, 2, seed=2), randn(4, seed=3)
    noise = spd(4, seed=4) if is_full else randn(4, seed=4).square() + 0.5
    valid = torch.tensor([True, False, True, True])

    def run(*inputs: Tensor) -> tuple[Tensor, ...]:
        mean, root, innovation, rows, noise = inputs
        noise = noise @ noise.mT if is_full else noise
        holes = torch.where(valid, innovation, torch.nan)
        got = update_extended(Gaussian(mean, root @ root.mT), holes, rows, noise, valid=valid)
        return got.state.mean, got.state.covariance, got.nis

    inputs = tuple(x.requires_grad_() for x in (randn(3, seed=5), root, innovation, rows, noise))
    assert torch.autograd.gradcheck(run, inputs)


def test_wrapping_ends_in_half_a_period_either_way() -> None:
    period = torch.tensor([math.pi, 2 * math.pi, math.inf, 4.0], dtype=torch.float64)
    difference = torch.tensor([[3.0, 3.5, 100.0, 2.0], [-3.0, -3.5, -100.0, -2.0]], dtype=torch.float64)
    got = wrapped(difference, period)
    assert got[0].tolist() == pytest.approx([3.0 - math.pi, 3.5 - 2 * math.pi, 100.0, 2.0], abs=1e-15)
    assert got[1].tolist() == pytest.approx([math.pi - 3.0, 2 * math.pi - 3.5, -100.0, 2.0], abs=1e-15)
    values = 50 * randn(7, 4, seed=1)
    close(wrapped(values + 3 * period.where(period.isfinite(), 0.0), period), wrapped(values, period), 1e-12)
    turns = (values - wrapped(values, period)) / period
    close(turns, turns.round(), 1e-12)
    assert torch.autograd.gradcheck(lambda x: wrapped(x, period), (randn(3, 4, seed=2).requires_grad_(),))


EYE2 = torch.eye(2, dtype=torch.float64)
STATE = Gaussian(torch.zeros(2, dtype=torch.float64), EYE2)
TWO = torch.ones(2, dtype=torch.float64)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: update_extended(STATE, TWO, EYE2, TWO, gate=0.0), r"gate must be None or above 0, got 0\.0"),
        (lambda: update_extended(STATE, TWO, EYE2, TWO, group=3), "group must divide the 2 measurements, got 3"),
        (lambda: update_extended(STATE, TWO, EYE2, TWO * 0), "noise must be above 0 wherever a measurement is valid"),
        (lambda: update_extended(STATE, TWO, EYE2, TWO[:1]), r"variances \(\*batch, 2\) or .* got shape \(1,\)"),
        (
            lambda: update_extended(STATE, TWO, torch.ones(2, 3).double(), TWO),
            "jacobian must have 1 to 2 columns, got 3",
        ),
    ],
)
def test_errors_are_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
