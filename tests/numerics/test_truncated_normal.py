"""Truncated normals against scipy, numerical integrals and each other."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import norm, truncnorm

from torchhand.numerics.truncated_normal import (
    log_ndtr,
    log_normal_mass,
    truncated_normal_log_prob,
    truncated_normal_quantile,
)

INTERVALS = [
    (-1.0, 2.0),
    (-0.1, 0.1),
    (3.0, 4.0),
    (-9.0, -8.0),
    (20.0, 21.0),
    (-60.0, -59.0),
    (-200.0, 3.0),
    (5.0, 5.001),
]


@pytest.mark.parametrize(("low", "high"), INTERVALS)
def test_density_is_scipys(low: float, high: float) -> None:
    mean, std = 0.3, 0.7
    points = np.linspace(low, high, 9)
    expected = truncnorm.logpdf(points, (low - mean) / std, (high - mean) / std, loc=mean, scale=std)
    ends = [torch.tensor(x, dtype=torch.float64) for x in (mean, std, low, high)]
    found = truncated_normal_log_prob(torch.from_numpy(points), *ends)
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(("low", "high"), INTERVALS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_integrates_to_one(low: float, high: float, dtype: torch.dtype) -> None:
    points = torch.linspace(low, high, 200_001, dtype=torch.float64)
    ends = [torch.tensor(x, dtype=dtype) for x in (0.3, 0.7, low, high)]
    density = truncated_normal_log_prob(points.to(dtype), *ends).double().exp()
    wrong = 2e-9 if dtype == torch.float64 else 3e-3
    assert float(torch.trapezoid(density, points)) == pytest.approx(1.0, abs=max(wrong, 1e-7 * abs(low) ** 3))


@pytest.mark.parametrize(("low", "high"), INTERVALS)
def test_quantiles_invert_the_distribution(low: float, high: float) -> None:
    """The mass below the quantile, by this module's own stable mass, is the share asked for."""
    fraction = torch.tensor((0.0, 1e-9, 0.1, 0.5, 0.9, 1.0), dtype=torch.float64)
    mean, std = torch.tensor(0.3).double(), torch.tensor(0.7).double()
    start, stop = torch.tensor(low).double(), torch.tensor(high).double()
    value = truncated_normal_quantile(fraction, mean, std, start, stop)
    assert bool(((value >= start) & (value <= stop)).all())
    a, b, x = ((end - mean) / std for end in (start, stop, value))
    below = (log_normal_mass(a.expand(6), x) - log_normal_mass(a, b)).exp()
    torch.testing.assert_close(
        below[1:], fraction[1:], atol=1e-6 if low > -50 else 1e-2, rtol=1e-6 if low > -50 else 1e-2
    )


def test_sample_moments(generator: torch.Generator) -> None:
    fraction = torch.rand(200_000, generator=generator, dtype=torch.float64)
    ends = [torch.tensor(x, dtype=torch.float64) for x in (0.5, 1.0, 0.0, 3.0)]
    drawn = truncated_normal_quantile(fraction, *ends).numpy()
    reference = truncnorm(-0.5, 2.5, loc=0.5)
    assert drawn.mean() == pytest.approx(reference.mean(), abs=4 * reference.std() / math.sqrt(len(drawn)))
    assert drawn.std() == pytest.approx(reference.std(), rel=0.01)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_nan_anywhere(dtype: torch.dtype, generator: torch.Generator) -> None:
    """Means far off, narrow intervals, shares at the ends: finite values and finite gradients."""
    low = 40 * torch.randn(20_000, generator=generator, dtype=dtype)
    high = low + 10 ** (6 * torch.rand(20_000, generator=generator, dtype=dtype) - 4) + 1e-4
    fraction = torch.rand(20_000, generator=generator, dtype=dtype).round(decimals=1)
    zero, one = torch.zeros((), dtype=dtype), torch.ones((), dtype=dtype)
    value = truncated_normal_quantile(fraction, zero, one, low, high)
    assert bool(((value >= low) & (value <= high)).all())
    leaves = [x.expand(20_000).clone().requires_grad_() for x in (value, zero, one, low, high)]
    density = truncated_normal_log_prob(*leaves)
    assert bool(density.isfinite().all())
    assert all(bool(x.isfinite().all()) for x in torch.autograd.grad(density.sum(), leaves))


def test_mass_of_everything() -> None:
    ends = torch.tensor((-math.inf, 0.0, -math.inf)).double(), torch.tensor((math.inf, math.inf, 1.0)).double()
    expected = torch.tensor((0.0, math.log(0.5), norm.logcdf(1.0))).double()
    torch.testing.assert_close(log_normal_mass(*ends), expected, atol=1e-7, rtol=0)


def test_derivatives(generator: torch.Generator) -> None:
    value, mean = torch.rand(2, 30, generator=generator, dtype=torch.float64).requires_grad_().unbind(0)
    std = (0.2 + torch.rand(30, generator=generator, dtype=torch.float64)).requires_grad_()
    low = (-2 * torch.rand(30, generator=generator, dtype=torch.float64)).requires_grad_()
    high = (1 + torch.rand(30, generator=generator, dtype=torch.float64)).requires_grad_()
    inputs = tuple(x.detach().requires_grad_() for x in (value, mean, std, low, high))
    assert torch.autograd.gradcheck(truncated_normal_log_prob, inputs)
    assert torch.autograd.gradgradcheck(truncated_normal_log_prob, inputs)


def test_log_ndtr(generator: torch.Generator) -> None:
    points = np.concatenate((np.linspace(-300, 40, 3000), np.linspace(-1.01, -0.99, 50)))
    found = log_ndtr(torch.from_numpy(points)).numpy()
    np.testing.assert_allclose(found, norm.logcdf(points), rtol=1e-13, atol=1e-300)
    single = log_ndtr(torch.from_numpy(points).float()).double().numpy()
    np.testing.assert_allclose(single, norm.logcdf(points.astype(np.float32)), rtol=5e-6, atol=1e-12)
    ends = torch.tensor((-math.inf, math.inf, math.nan)).double()
    assert log_ndtr(ends)[:2].tolist() == [-math.inf, 0.0]
    assert math.isnan(log_ndtr(ends)[2])
    inner = (3 * torch.randn(50, generator=generator, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradgradcheck(log_ndtr, inner)
    slopes = torch.func.vmap(torch.func.grad(log_ndtr))(inner.detach())
    torch.testing.assert_close(slopes, torch.autograd.grad(log_ndtr(inner).sum(), inner)[0], atol=0, rtol=1e-14)
