"""Learned noise: samples that are right on average, definite matrices, bounds, and convergence to the true noise."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from torchhand.numerics.filters.adaptive import (
    AdaptiveNoiseSettings,
    adapted_variance,
    gain_covariance,
    noise_density,
    process_covariance,
)
from torchhand.numerics.filters.extended import update_extended
from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.numerics.filters.motion import MotionModel
from torchhand.numerics.filters.unscented import predict_linear

DT_S = 0.1
MODEL = MotionModel(order=1)
H = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], dtype=torch.float64)  # two positions, and their sum
TRUE_R = torch.tensor([0.04, 0.09, 0.25], dtype=torch.float64)
TRUE_DENSITY = torch.tensor([2.0, 0.5], dtype=torch.float64)


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def spd(*shape: int, seed: int, floor: float = 0.1) -> Tensor:
    root = randn(*shape, shape[-1], seed=seed)
    return root @ root.mT + floor * torch.eye(shape[-1], dtype=torch.float64)


def close(got: Tensor, expected: Tensor, tolerance: float = 1e-10) -> None:
    assert got.shape == expected.shape
    assert torch.allclose(got, expected, rtol=0, atol=tolerance), float((got - expected).abs().max())


class Run:
    """Many independent filters on simulated motion; what each step saw is kept for the learner."""

    def __init__(self, runs: int, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)
        self.truth = torch.zeros(runs, 4, dtype=torch.float64)
        self.belief = Gaussian(self.truth.clone(), torch.eye(4, dtype=torch.float64).expand(runs, 4, 4))
        self.root = torch.linalg.cholesky(MODEL.process_noise(DT_S, TRUE_DENSITY))
        self.step_matrix = MODEL.transition(DT_S, 2)

    def step(self, density: Tensor, variance: Tensor) -> float:
        """One frame with the given noise; the mean NIS per measurement."""

        def draw(*shape: int) -> Tensor:
            return torch.randn(*shape, generator=self.generator, dtype=torch.float64)

        runs = len(self.truth)
        self.truth = self.truth @ self.step_matrix.mT + draw(runs, 4) @ self.root.mT
        z = self.truth[:, :2] @ H.mT + draw(runs, 3) * TRUE_R.sqrt()
        self.predicted = predict_linear(self.belief, self.step_matrix, MODEL.process_noise(DT_S, density))
        innovation = z - self.predicted.mean[:, :2] @ H.mT
        result = update_extended(self.predicted, innovation, H, variance.expand(runs, 3))
        self.belief = result.state
        self.residual = z - self.belief.mean[:, :2] @ H.mT
        return float(result.nis.mean() / 3)


WIDE = AdaptiveNoiseSettings(forgetting=0.98, floor=1e-3, ceiling=1e3)
FAST = AdaptiveNoiseSettings(forgetting=0.95, floor=1e-3, ceiling=1e3)


FACTORS = torch.tensor([8.0, 0.125], dtype=torch.float64).repeat_interleave(40)[
    :, None
]  # half too large, half too small


def test_process_noise_converges_to_the_true_one() -> None:
    run = Run(80, seed=3)
    density = nominal = FACTORS * TRUE_DENSITY
    total = torch.zeros_like(density)
    for index in range(800):
        run.step(density, TRUE_R)
        sample = process_covariance(run.predicted, run.belief, MODEL.process_noise(DT_S, density))
        density = adapted_variance(density, noise_density(sample, MODEL, DT_S), nominal, FAST)
        total = total + density / 400 * (index >= 400)
    for half in total.split(40):
        assert torch.allclose(half.mean(0), TRUE_DENSITY, rtol=0.15, atol=0), half.mean(0)


def test_the_plain_sample_finds_the_noise_of_a_random_walk_and_not_that_of_a_velocity() -> None:
    """The sample G ν νᵀ Gᵀ averages to P⁻ - P⁺, which is Q for a random walk in its steady state."""
    walk, rate = MotionModel(order=0), torch.tensor([0.7], dtype=torch.float64)
    generator = torch.Generator().manual_seed(4)
    truth, r = torch.zeros(400, 1, dtype=torch.float64), torch.full((400, 1), 0.3, dtype=torch.float64)
    belief, unit = Gaussian(truth.clone(), torch.ones(400, 1, 1, dtype=torch.float64)), torch.eye(1).double()
    samples = []
    for index in range(60):
        truth = truth + (rate * DT_S).sqrt() * torch.randn(400, 1, generator=generator, dtype=torch.float64)
        z = truth + r.sqrt() * torch.randn(400, 1, generator=generator, dtype=torch.float64)
        predicted = predict_linear(belief, walk.transition(DT_S, 1), walk.process_noise(DT_S, rate))
        belief = update_extended(predicted, z - predicted.mean, unit, r).state
        if index >= 30:
            samples.append(gain_covariance(predicted, belief))
    assert float(torch.stack(samples).mean()) == pytest.approx(float(rate) * DT_S, rel=0.03)

    run = Run(400, seed=5)
    plain, exact = [], []
    for index in range(60):
        run.step(TRUE_DENSITY, TRUE_R)
        if index >= 30:
            plain.append(gain_covariance(run.predicted, run.belief))
            exact.append(process_covariance(run.predicted, run.belief, MODEL.process_noise(DT_S, TRUE_DENSITY)))
    truth = MODEL.process_noise(DT_S, TRUE_DENSITY)
    found = torch.stack(exact).mean((0, 1))
    assert torch.allclose(found, truth, rtol=0.02, atol=5e-4)
    assert torch.allclose(noise_density(found, MODEL, DT_S), TRUE_DENSITY, rtol=0.02, atol=0)
    assert float(torch.stack(plain).mean((0, 1))[0, 0]) > 10 * float(truth[0, 0])


def test_a_sudden_change_of_noise_is_followed_at_the_rate_of_forgetting() -> None:
    settings = AdaptiveNoiseSettings(forgetting=0.9)
    variance = torch.ones(1, dtype=torch.float64)
    for _ in range(7):
        variance = adapted_variance(variance, 5 * torch.ones(1).double(), torch.ones(1).double(), settings)
    assert float(variance) == pytest.approx(5 - 4 * 0.9**7, abs=1e-12)


def test_a_process_sample_is_the_noise_and_what_the_innovation_has_too_much() -> None:
    noise, before, rows, r = spd(3, seed=1), spd(3, seed=2), randn(2, 3, seed=3), spd(2, seed=4)
    predicted = Gaussian(randn(3, seed=5), before + noise)
    innovation = randn(2, seed=6)
    updated = update_extended(predicted, innovation, rows, r).state
    full = rows @ predicted.covariance @ rows.mT + r
    gain = predicted.covariance @ rows.mT @ torch.linalg.inv(full)
    expected = noise + gain @ (innovation[:, None] * innovation - full) @ gain.mT
    close(process_covariance(predicted, updated, noise), expected)
    close(gain_covariance(predicted, updated), gain @ (innovation[:, None] * innovation) @ gain.mT)
    close(process_covariance(predicted, predicted, noise), noise, 0)  # no measurement: nothing new


@pytest.mark.parametrize("noise", ["white", "piecewise"])
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("dt_s", [1 / 240, 0.5])
def test_density_is_the_inverse_of_process_noise(order: int, noise: str, dt_s: float) -> None:
    model = MotionModel(order=order, noise=noise, acceleration_decay_s=0.3)  # pyright: ignore[reportArgumentType]
    density = randn(2, 3, 4, seed=1).square()
    close(noise_density(model.process_noise(dt_s, density), model, dt_s) / density, torch.ones_like(density), 1e-9)


def test_estimates_stay_within_floor_and_ceiling() -> None:
    settings = AdaptiveNoiseSettings(forgetting=0.6, floor=0.1, ceiling=4.0)
    nominal = randn(2, 3, seed=1).square() + 0.1
    estimate = nominal.clone()
    for index in range(60):
        sample = randn(2, 3, seed=100 + index).square() * (0.0 if index > 40 else 100.0 if index % 7 == 0 else 1.0)
        estimate = adapted_variance(estimate, sample, nominal, settings)
        assert float((estimate / nominal).min()) > 0.1 - 1e-9
        assert float((estimate / nominal).max()) < 4.0 + 1e-9
    close(estimate, 0.1 * nominal)  # zeros lead to the floor


def test_what_is_not_used_or_not_finite_teaches_nothing() -> None:
    estimate, sample, nominal = (randn(5, seed=s).square() + 0.1 for s in (1, 2, 3))
    wide = AdaptiveNoiseSettings(forgetting=0.9, floor=1e-6, ceiling=1e6)
    used = torch.tensor([True, True, False, True, False])
    expected = (0.9 * estimate + 0.1 * sample).where(used, estimate)
    close(adapted_variance(estimate, sample.where(used, torch.inf), nominal, wide), expected)
    close(adapted_variance(estimate, sample.where(used, torch.nan), nominal, wide, used=used), expected)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_a_batch_is_a_loop(batch: tuple[int, ...]) -> None:
    updated = Gaussian(randn(*batch, 6, seed=9), spd(*batch, 6, seed=10))
    noise = 0.5 * spd(*batch, 6, seed=11)
    predicted = Gaussian(randn(*batch, 6, seed=12), updated.covariance + noise)
    calls: list[Callable[..., Tensor]] = [
        lambda x, p, y, c, q: process_covariance(Gaussian(y, c), Gaussian(x, p), q),
        lambda x, p, y, c, q: noise_density(gain_covariance(Gaussian(y, c), Gaussian(x, p)), MODEL, DT_S),
    ]
    inputs = (updated.mean, updated.covariance, predicted.mean, predicted.covariance, noise)
    flat = [x.reshape(-1, *x.shape[len(batch) :]) for x in inputs]
    for call in calls:
        got = call(*inputs)
        close(got, torch.stack([call(*one) for one in zip(*flat, strict=True)]).reshape(got.shape), 1e-9)


def test_derivatives_reach_the_samples() -> None:
    rows, noise, before = randn(2, 3, seed=1), spd(3, seed=2), spd(3, seed=3)

    def run(innovation: Tensor, mean: Tensor) -> Tensor:
        predicted = Gaussian(mean, before + noise)
        updated = update_extended(predicted, innovation, rows, torch.eye(2, dtype=torch.float64)).state
        return process_covariance(predicted, updated, noise)

    assert torch.autograd.gradcheck(run, tuple(randn(n, seed=n).requires_grad_() for n in (2, 3)))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"forgetting": 1.0}, r"adaptive\.forgetting: expected above 0 and below 1, got 1\.0"),
        ({"floor": 0.0}, r"adaptive\.floor: expected above 0, got 0\.0"),
        ({"floor": 2.0, "ceiling": 1.0}, r"adaptive\.ceiling: expected finite and at least the floor 2\.0, got 1\.0"),
    ],
)
def test_settings_are_checked(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AdaptiveNoiseSettings(**values)


def test_a_noise_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="multiple of 2 numbers, which order 1 needs, got 3"):
        noise_density(torch.eye(3), MODEL, DT_S)
