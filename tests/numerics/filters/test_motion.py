from dataclasses import replace
from typing import Literal

import filterpy.common
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import torch

from torchhand.numerics.filters.motion import MotionModel

DT_S = 1 / 30
DENSITY = torch.tensor([0.7, 3.0], dtype=torch.float64)
ALL_WHITE = [
    MotionModel(order=0),
    MotionModel(order=1),
    MotionModel(order=2),
    MotionModel(order=1, velocity_decay_s=0.2),
    MotionModel(order=2, acceleration_decay_s=0.1),
    MotionModel(order=2, velocity_decay_s=0.5, acceleration_decay_s=0.1),
    MotionModel(order=2, velocity_decay_s=0.004, acceleration_decay_s=0.001),
]


def drift(model: MotionModel) -> np.ndarray:
    decays_s = [None, model.velocity_decay_s, model.acceleration_decay_s][: model.order + 1]
    return np.diag(np.ones(model.order), 1) - np.diag([0.0 if d is None else 1 / d for d in decays_s])


@pytest.mark.parametrize("model", ALL_WHITE, ids=str)
def test_matrices_match_numerical_integration(model: MotionModel) -> None:
    size = model.order + 1

    def integrand(time_s: float) -> np.ndarray:
        column = scipy.linalg.expm(drift(model) * time_s)[:, -1]
        return np.outer(column, column).ravel()

    noise, _ = scipy.integrate.quad_vec(integrand, 0, DT_S, epsabs=1e-14, epsrel=1e-12, norm="max")
    block = torch.from_numpy(noise.reshape(size, size))
    transition = torch.from_numpy(scipy.linalg.expm(drift(model) * DT_S))
    powers = torch.tensor([DT_S**i for i in range(size)], dtype=torch.float64)
    scale = DT_S ** (2 * model.order + 1) / torch.outer(powers, powers)
    got = model.process_noise(DT_S, DENSITY) / torch.kron(scale, torch.ones(2, 2))
    assert torch.allclose(got, torch.kron(block / scale, torch.diag(DENSITY)), rtol=0, atol=1e-9)
    step = model.transition(DT_S, 2)
    assert torch.allclose(step, torch.kron(transition, torch.eye(2, dtype=torch.float64)), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("model", ALL_WHITE, ids=str)
def test_two_steps_are_one_of_twice_the_length(model: MotionModel) -> None:
    step, noise = model.transition(DT_S, 2), model.process_noise(DT_S, DENSITY)
    assert torch.allclose(model.transition(2 * DT_S, 2), step @ step, rtol=1e-12, atol=1e-15)
    twice = step @ noise @ step.mT + noise
    assert torch.allclose(model.process_noise(2 * DT_S, DENSITY), twice, rtol=1e-11, atol=1e-22)


def test_undamped_white_noise_is_the_textbook_polynomial() -> None:
    one = torch.ones(1, dtype=torch.float64)
    dt = DT_S
    jerk = [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
    for order in (0, 1, 2):
        corner = torch.tensor(jerk, dtype=torch.float64)[2 - order :, 2 - order :]
        got = MotionModel(order=order).process_noise(dt, one)
        assert torch.allclose(got, corner, rtol=1e-13, atol=0)


@pytest.mark.parametrize("order", [1, 2])
def test_piecewise_noise_matches_filterpy(order: Literal[1, 2]) -> None:
    expected = filterpy.common.Q_discrete_white_noise(order + 1, DT_S, 2.5)
    model = MotionModel(order=order, noise="piecewise")
    got = model.process_noise(DT_S, torch.tensor([2.5], dtype=torch.float64))
    assert torch.allclose(got, torch.from_numpy(expected), rtol=1e-13, atol=0)


def test_piecewise_noise_of_a_decaying_velocity() -> None:
    decay_s = 0.05
    model = MotionModel(order=1, noise="piecewise", velocity_decay_s=decay_s)
    left = float(np.exp(-DT_S / decay_s))
    gain = torch.tensor([decay_s * (DT_S - decay_s * (1 - left)), decay_s * (1 - left)], dtype=torch.float64)
    got = model.process_noise(DT_S, torch.ones(1, dtype=torch.float64))
    assert torch.allclose(got, torch.outer(gain, gain), rtol=1e-12, atol=0)


def test_state_is_laid_out_in_blocks() -> None:
    state = torch.tensor([1.0, 2.0, 0.5, -1.0, 0.0, 6.0], dtype=torch.float64)
    model = MotionModel(order=2)
    moved = model.transition(2.0, 2) @ state
    assert model.state_size(2) == 6
    assert moved.tolist() == pytest.approx([2.0, 12.0, 0.5, 11.0, 0.0, 6.0], abs=1e-12)


def test_decay_bounds_an_extrapolation() -> None:
    state = torch.tensor([0.0, 1.0, 50.0], dtype=torch.float64)
    model = MotionModel(order=2, velocity_decay_s=0.1, acceleration_decay_s=0.1)
    far = model.transition(100.0, 1) @ state
    assert far.tolist() == pytest.approx([0.1 * 1.0 + 0.1 * 0.1 * 50.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("noise", ["white", "piecewise"])
@pytest.mark.parametrize(("order", "velocity_decay_s"), [(0, 0.2), (1, None)])
def test_decay_of_a_derivative_that_the_order_lacks_is_ignored(
    order: Literal[0, 1], velocity_decay_s: float | None, noise: Literal["white", "piecewise"]
) -> None:
    plain = MotionModel(order=order, noise=noise)
    decaying = replace(plain, velocity_decay_s=velocity_decay_s, acceleration_decay_s=0.1)
    assert torch.equal(decaying.transition(DT_S, 2), plain.transition(DT_S, 2))
    assert torch.equal(decaying.process_noise(DT_S, DENSITY), plain.process_noise(DT_S, DENSITY))


def test_densities_may_be_batched() -> None:
    densities = torch.rand(2, 3, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    model = MotionModel(order=1)
    got = model.process_noise(DT_S, densities)
    for i in range(2):
        for j in range(3):
            assert torch.equal(got[i, j], model.process_noise(DT_S, densities[i, j]))


def test_settings_are_checked() -> None:
    with pytest.raises((ValueError, TypeError), match=r"(?s)order.*3"):  # TypeError: from the hook
        MotionModel(order=3)  # type: ignore[arg-type]
    with pytest.raises((ValueError, TypeError), match=r"(?s)noise.*pink"):
        MotionModel(noise="pink")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"velocity_decay_s must be None or above 0 s, got 0\.0"):
        MotionModel(velocity_decay_s=0.0)
    with pytest.raises(ValueError, match=r"acceleration_decay_s must be None or above 0 s, got -1\.0"):
        MotionModel(order=1, acceleration_decay_s=-1.0)  # ignored, and wrong nevertheless
    with pytest.raises(ValueError, match=r"dt_s must be finite and above 0 s, got 0\.0"):
        MotionModel().transition(0.0, 2)
