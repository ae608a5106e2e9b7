"""Covariances after an update: symmetric, finite and positive semi-definite, whatever the prior and the noise."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.numerics.filters.extended import update_extended
from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.iterated import update_iterated
from torchhand.numerics.filters.square_root import PosteriorRoot
from torchhand.numerics.filters.unscented import update

FILTERS = ["extended", "iterated", "unscented"]


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def rand(*shape: int, seed: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def prior(batch: int, size: int, decades: float, *, rank: int | None = None, seed: int) -> Tensor:
    """Covariances with eigenvalues over so many decades, the first 1 and those beyond the rank 0."""
    vectors = torch.linalg.qr(randn(batch, size, size, seed=seed)).Q
    values = 10 ** (-decades * rand(batch, size, seed=seed + 1))
    values[:, 0] = 1
    values[:, size if rank is None else rank :] = 0
    covariance = (vectors * values[:, None]) @ vectors.mT
    return 0.5 * (covariance + covariance.mT)


def updated(name: str, state: Gaussian, rows: Tensor, z: Tensor, variance: Tensor) -> Gaussian:
    """The update with linear measurements of the first k components by one of the filters."""
    columns = rows.shape[-1]

    def seen(x: Tensor) -> Tensor:
        return (rows @ x.unsqueeze(-1)).squeeze(-1)

    if name == "extended":
        return update_extended(state, z - seen(state.mean[..., :columns]), rows, variance).state
    if name == "iterated":
        return update_iterated(
            state, lambda x: (seen(x), rows), Measurement(z, variance), observed=columns
        ).update.state
    return update(state, lambda x: x @ rows.mT, Measurement(z, variance), observed=columns).state


def textbook(state: Gaussian, rows: Tensor, z: Tensor, variance: Tensor) -> Gaussian:
    """x + K ν and P - K S Kᵀ with the inverse of S."""
    rows = torch.nn.functional.pad(rows, (0, state.mean.shape[-1] - rows.shape[-1]))
    full = rows @ state.covariance @ rows.mT + variance.diag_embed()
    gain = state.covariance @ rows.mT @ torch.linalg.inv(full)
    mean = state.mean + (gain @ (z - (rows @ state.mean[..., None])[..., 0])[..., None])[..., 0]
    return Gaussian(mean, state.covariance - gain @ full @ gain.mT)


def is_a_covariance(matrix: Tensor) -> None:
    """Symmetric exactly, finite, and no eigenvalue below minus some roundings of the largest."""
    assert matrix.isfinite().all()
    assert torch.equal(matrix, matrix.mT)
    values = torch.linalg.eigvalsh(matrix.double())
    fraction = float((values[:, 0] / values[:, -1]).min())
    assert fraction >= -matrix.shape[-1] * torch.finfo(matrix.dtype).eps, fraction


SIZES = [(6, 3, 6), (27, 12, 27), (27, 80, 27), (54, 27, 27), (8, 30, 8), (1, 1, 1)]
PRIORS: list[dict[str, Any]] = [{"decades": 2}, {"decades": 6}, {"decades": 12}, {"decades": 4, "rank": 1}]


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("n", "m", "k"), SIZES)
def test_no_update_leaves_an_indefinite_covariance(name: str, dtype: torch.dtype, n: int, m: int, k: int) -> None:
    """Priors down to rank one, with units over six decades or with one; noise over up to 16 decades."""
    batch = 24
    for index, shape in enumerate(PRIORS):
        for decades in (1, 4, 8):
            for units in (0, 3):
                seed = 1000 * index + 10 * decades + units
                unit = 10 ** (units * (2 * rand(batch, n, seed=seed + 3) - 1))
                covariance = unit[..., None] * prior(batch, n, **shape, seed=seed) * unit[:, None]
                rows = randn(m, k, seed=seed + 4) if units == 0 else randn(m, k, seed=seed + 4) / unit.mean(0)[:k]
                variance = 10 ** (decades * (2 * rand(batch, m, seed=seed + 5) - 1))
                z = randn(batch, m, seed=seed + 6)
                numbers = [x.to(dtype) for x in (unit * randn(batch, n, seed=seed + 7), covariance, rows, z, variance)]
                mean, covariance, rows, z, variance = numbers
                got = updated(name, Gaussian(mean, covariance), rows, z, variance)
                is_a_covariance(got.covariance)
                assert got.mean.isfinite().all()


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_long_run_without_process_noise_stays_a_covariance(name: str, dtype: torch.dtype) -> None:
    """Many updates, each of which makes the covariance a little smaller and less well conditioned."""
    n, m, batch = 6, 2, 4
    state = Gaussian(torch.zeros(batch, n, dtype=dtype), 1e3 * torch.eye(n, dtype=dtype).expand(batch, n, n))
    rows = randn(150, m, n, seed=1).to(dtype)
    rows[:, 1] = rows[:, 0] + 1e-4 * rows[:, 1]  # nearly the same direction twice
    variance = (10 ** (6 * rand(150, batch, m, seed=2) - 5)).to(dtype)
    for index in range(150):
        z = variance[index].sqrt() * randn(batch, m, seed=index).to(dtype)
        state = updated(name, state, rows[index], z, variance[index])
        is_a_covariance(state.covariance)
    assert float(state.mean.abs().max()) < 0.1


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize(("n", "m", "k"), SIZES)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-5), (torch.float64, 1e-12)])
def test_well_conditioned_updates_are_the_textbook_s(
    name: str, n: int, m: int, k: int, dtype: torch.dtype, tolerance: float
) -> None:
    covariance, rows = prior(50, n, decades=1, seed=1), randn(m, k, seed=2)
    state = Gaussian(randn(50, n, seed=3), covariance)
    z, variance = randn(50, m, seed=4), 0.1 + rand(50, m, seed=5)
    expected = textbook(state, rows, z, variance)
    got = updated(
        name, Gaussian(state.mean.to(dtype), covariance.to(dtype)), rows.to(dtype), z.to(dtype), variance.to(dtype)
    )
    assert torch.allclose(got.mean.double(), expected.mean, rtol=0, atol=tolerance * (1 + float(z.abs().max())))
    assert torch.allclose(got.covariance.double(), expected.covariance, rtol=0, atol=tolerance)


@pytest.mark.parametrize("name", ["extended", "iterated"])
@pytest.mark.parametrize("decades", [4, 8])
def test_float32_keeps_what_a_precise_measurement_does_not_see(name: str, decades: int) -> None:
    """Noise far below the prior in some directions; the others, which nobody measured, must not change.

    A sum I + BᵀB in float32 loses the I beside measurements 1500 times better than the prior.
    """
    n, m, batch = 27, 12, 100
    covariance, rows = prior(batch, n, decades=2, seed=1).float(), randn(m, n, seed=2).float()
    variance = (10 ** (-decades * rand(batch, m, seed=3))).float()
    state = Gaussian(torch.zeros(batch, n), covariance)
    got = updated(name, state, rows, torch.zeros(batch, m), variance).covariance.double()
    exact = textbook(
        Gaussian(state.mean.double(), covariance.double()),
        rows.double(),
        torch.zeros(batch, m, dtype=torch.float64),
        variance.double(),
    ).covariance
    error = torch.linalg.matrix_norm(got - exact) / torch.linalg.matrix_norm(exact)
    assert float(error.max()) < n * torch.finfo(torch.float32).eps * 10 ** (decades / 2)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_nis_is_never_negative_and_that_of_the_innovation_s_covariance(name: str, dtype: torch.dtype) -> None:
    n, m, batch = 6, 40, 100
    covariance, rows = prior(batch, n, decades=3, seed=1).to(dtype), randn(m, n, seed=2).to(dtype)
    state, variance = Gaussian(torch.zeros(batch, n, dtype=dtype), covariance), torch.full((batch, m), 1e-6).to(dtype)
    calls: dict[str, Callable[[Tensor], Any]] = {
        "extended": lambda z: update_extended(state, z, rows, variance),
        "iterated": lambda z: update_iterated(state, lambda x: (x @ rows.mT, rows), Measurement(z, variance)).update,
        "unscented": lambda z: update(state, lambda x: x @ rows.mT, Measurement(z, variance)),
    }
    # All of the innovation is explained by the state: ν lies in the span of H, and NIS is that of the state's change.
    y = randn(batch, n, seed=3).to(dtype)
    z = (rows @ torch.linalg.cholesky(covariance) @ y[..., None])[..., 0]
    got = calls[name](z).nis
    assert float(got.min()) >= 0
    full = rows.double() @ covariance.double() @ rows.double().mT + variance.double().diag_embed()
    expected = (z.double() * torch.linalg.solve(full, z.double())).sum(-1)
    tolerance = 1e-6 if dtype == torch.float64 else 2e-2
    assert torch.allclose(got.double(), expected, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_the_root_solves_the_least_squares_problem_it_is_of(batch: tuple[int, ...]) -> None:
    rows, residual, offset = randn(*batch, 7, 4, seed=1), randn(*batch, 7, seed=2), randn(*batch, 4, seed=3)
    root = PosteriorRoot.of(rows)
    step, length = root.step(residual, offset)
    information = rows.mT @ rows + torch.eye(4, dtype=torch.float64)
    gradient = (rows.mT @ residual[..., None])[..., 0] - offset
    expected = torch.linalg.solve(information, gradient)
    assert torch.allclose(step, expected, rtol=0, atol=1e-13)
    assert torch.allclose(length, (expected * gradient).sum(-1).sqrt(), rtol=0, atol=1e-13)
    left = randn(*batch, 5, 4, seed=4)
    assert torch.allclose(root.covariance(left), left @ torch.linalg.inv(information) @ left.mT, rtol=0, atol=1e-13)


def test_a_lost_filter_of_a_batch_does_not_stop_the_others() -> None:
    covariance = prior(3, 4, decades=1, seed=1)
    covariance[1] = torch.nan
    state, rows = Gaussian(torch.zeros(3, 4, dtype=torch.float64), covariance), randn(5, 4, seed=2)
    z, variance = randn(3, 5, seed=3), torch.ones(3, 5, dtype=torch.float64)
    for name in FILTERS:
        got = updated(name, state, rows, z, variance)
        for index in (0, 2):
            alone = updated(name, Gaussian(state.mean[index], covariance[index]), rows, z[index], variance[index])
            assert torch.allclose(got.mean[index], alone.mean, rtol=0, atol=1e-12)
            assert torch.allclose(got.covariance[index], alone.covariance, rtol=0, atol=1e-12)
