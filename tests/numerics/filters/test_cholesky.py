import pytest
import torch

from torchhand.numerics.filters.cholesky import robust_cholesky, semidefinite


def random_spd(*batch: int, size: int = 5, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(*batch, size, size, generator=generator, dtype=torch.float64)
    matrix = root @ root.mT + 0.1 * torch.eye(size, dtype=torch.float64)
    return 0.5 * (matrix + matrix.mT)  # products by other kernels are symmetric to rounding only


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_good_matrices_are_factored_exactly(batch: tuple[int, ...]) -> None:
    matrix = random_spd(*batch)
    assert torch.equal(robust_cholesky(matrix), torch.linalg.cholesky(matrix))


def test_only_the_symmetric_part_counts() -> None:
    matrix = random_spd()
    skew = torch.triu(torch.ones_like(matrix), 1)
    factor = robust_cholesky(matrix + skew - skew.mT)
    assert torch.allclose(factor @ factor.mT, matrix, rtol=0, atol=1e-13)


def test_a_bad_matrix_does_not_touch_its_neighbours() -> None:
    matrices = random_spd(2, 3)
    matrices[1, 0] = torch.diag(torch.tensor([1.0, 2.0, -1e-3, 1.0, 3.0], dtype=torch.float64))
    matrices[0, 2] = torch.nan
    factor = robust_cholesky(matrices)
    good = torch.tensor([[True, True, False], [False, True, True]])
    assert torch.equal(factor[good], torch.linalg.cholesky(matrices[good]))
    assert factor[0, 2].isnan().all()
    assert factor[1, 0].isfinite().all()


def test_singular_matrix_gets_the_smallest_jitter() -> None:
    root = torch.randn(6, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    matrix = root @ root.mT - 1e-13 * torch.eye(6, dtype=torch.float64)
    factor = robust_cholesky(matrix)
    expected = matrix + 1e-10 * matrix.diagonal().diag()
    assert torch.allclose(factor @ factor.mT, expected, rtol=0, atol=1e-14)
    assert torch.equal(factor, factor.tril())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_repair_of_a_singular_matrix_is_relative_to_each_number_s_unit(dtype: torch.dtype) -> None:
    """Covariance of metres beside radians per second: what is added to one must not drown the other."""
    root = torch.randn(6, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    matrix = (root @ root.mT).to(dtype)
    unit = torch.tensor([2.0**10, 2.0**-10, 1.0, 2.0**6, 2.0**-16, 4.0], dtype=dtype)
    scaled = unit[:, None] * matrix * unit
    assert int(torch.linalg.cholesky_ex(scaled - 1e-7 * scaled.diagonal().diag()).info)
    factor = robust_cholesky(scaled - 1e-7 * scaled.diagonal().diag())
    error = (factor @ factor.mT - scaled) / unit[:, None] / unit
    assert float(error.abs().max()) < 3e-6 * float(matrix.diagonal().max())


def test_indefinite_matrix_gives_the_factor_of_its_clipped_form() -> None:
    vectors = torch.linalg.qr(random_spd(seed=5)).Q
    values = torch.tensor([4.0, 2.0, 1.0, -0.5, -1.0], dtype=torch.float64)
    factor = robust_cholesky(vectors * values @ vectors.mT)
    clipped = vectors * values.clamp_min(4e-12) @ vectors.mT
    assert torch.allclose(factor @ factor.mT, clipped, rtol=0, atol=1e-13)
    assert torch.equal(factor, factor.tril())
    assert (factor.diagonal() >= 0).all()


@pytest.mark.parametrize("sign", [0.0, -1.0])
def test_nothing_positive_gives_zeros(sign: float) -> None:
    factor = robust_cholesky(sign * torch.eye(3, dtype=torch.float64))
    assert torch.equal(factor, torch.zeros(3, 3, dtype=torch.float64))


def test_gradient_flows_past_a_repaired_neighbour() -> None:
    good = random_spd(size=3)

    def product(matrix: torch.Tensor) -> torch.Tensor:
        bad = torch.diag(torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64))
        return robust_cholesky(torch.stack([matrix, bad]))[0]

    assert torch.autograd.gradcheck(product, good.requires_grad_())


# ------------------------------------------------------------------ covariances that rounding has broken


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_positive_definite_matrix_is_left_as_it_is(dtype: torch.dtype) -> None:
    root = torch.randn(5, 4, 4, generator=torch.Generator().manual_seed(0), dtype=dtype)
    matrix = root @ root.mT + 0.1 * torch.eye(4, dtype=dtype)
    assert semidefinite(matrix) is matrix


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_rounding_took_is_given_back_in_each_states_own_units(dtype: torch.dtype) -> None:
    """One of three matrices is off by its last digits; two of its states have units a billion times apart."""
    unit = torch.tensor([1e-6, 1.0, 1e3, 1.0], dtype=dtype)
    correlation = torch.full((4, 4), 1.0, dtype=dtype)
    correlation = correlation + 20 * torch.finfo(dtype).eps * (1 - torch.eye(4, dtype=dtype))
    sound = torch.eye(4, dtype=dtype)
    matrix = torch.stack((sound, correlation * unit * unit[:, None], torch.full_like(sound, torch.nan)))
    mended = semidefinite(matrix)
    assert torch.equal(mended[0], sound)
    assert bool(mended[2].isnan().all())
    one = mended[1].double() / (unit * unit[:, None]).double()
    torch.testing.assert_close(one, correlation.double(), atol=100 * torch.finfo(dtype).eps, rtol=0)
    assert float(torch.linalg.eigvalsh(one)[0]) > -8 * torch.finfo(dtype).eps
    assert float(torch.linalg.eigvalsh(matrix[1].double() / (unit * unit[:, None]).double())[0]) < (
        -10 * torch.finfo(dtype).eps
    )
    assert torch.equal(mended[1], mended[1].mT)


def test_a_variance_below_zero_becomes_zero_with_its_row() -> None:
    matrix = torch.tensor([[2.0, 0.1, 0.5], [0.1, -1e-9, 0.2], [0.5, 0.2, 1.0]], dtype=torch.float64)
    mended = semidefinite(matrix)
    expected = torch.tensor([[2.0, 0.0, 0.5], [0.0, 0.0, 0.0], [0.5, 0.0, 1.0]], dtype=torch.float64)
    torch.testing.assert_close(mended, expected, atol=1e-15, rtol=0)


def test_the_gradient_of_a_mended_matrix_is_that_of_the_matrix() -> None:
    matrix = torch.tensor([[1.0, 1.0001], [1.0001, 1.0]], dtype=torch.float64, requires_grad=True)
    weight = torch.tensor([[1.0, 2.0], [3.0, 4.0]], dtype=torch.float64)
    (semidefinite(matrix) * weight).sum().backward()
    assert matrix.grad is not None
    assert torch.equal(matrix.grad, weight)
