import pytest
import scipy.stats
import torch

from torchhand.numerics.filters.consistency import chi_square_quantile, mean_chi_square_band, nees, nis
from torchhand.numerics.filters.gaussian import Gaussian


@pytest.mark.parametrize("probability", [1e-6, 0.025, 0.5, 0.975, 0.999999])
def test_quantiles_match_scipy(probability: float) -> None:
    degrees = torch.tensor([[0.5, 1.0, 2.0], [27.0, 800.0, 50000.0]], dtype=torch.float64)
    expected = torch.from_numpy(scipy.stats.chi2.ppf(probability, degrees.numpy()))
    assert torch.allclose(chi_square_quantile(probability, degrees), expected, rtol=1e-9, atol=1e-15)


def test_band_of_a_mean_matches_scipy() -> None:
    low, high = mean_chi_square_band(6, 50, 0.9)
    assert low == pytest.approx(scipy.stats.chi2.ppf(0.05, 300) / 50, rel=1e-10)
    assert high == pytest.approx(scipy.stats.chi2.ppf(0.95, 300) / 50, rel=1e-10)


def test_normalised_squares_match_the_inverse() -> None:
    generator = torch.Generator().manual_seed(0)
    root = torch.randn(2, 3, 4, 4, generator=generator, dtype=torch.float64)
    covariance = root @ root.mT + torch.eye(4, dtype=torch.float64)
    mean, truth = torch.randn(2, 2, 3, 4, generator=generator, dtype=torch.float64)
    error = (truth - mean).unsqueeze(-1)
    expected = (error.mT @ torch.linalg.inv(covariance) @ error).squeeze((-1, -2))
    assert torch.allclose(nees(Gaussian(mean, covariance), truth), expected, rtol=1e-11, atol=0)
    assert torch.allclose(nis(truth - mean, covariance), expected, rtol=1e-11, atol=0)


def test_errors_are_named() -> None:
    with pytest.raises(ValueError, match=r"probability must be between 0 and 1, got 1\.0"):
        chi_square_quantile(1.0, torch.ones(1))
    with pytest.raises(ValueError, match="degrees must be above 0"):
        chi_square_quantile(0.5, torch.zeros(1))
    with pytest.raises(ValueError, match="degrees=0, count=3"):
        mean_chi_square_band(0, 3)
    with pytest.raises(ValueError, match=r"level must be between 0 and 1, got 95"):
        mean_chi_square_band(1, 3, 95.0)


def test_standard_deviation_is_the_root_of_the_diagonal() -> None:
    covariance = torch.tensor([[4.0, 1.0], [1.0, -1e-20]], dtype=torch.float64)
    assert Gaussian(torch.zeros(2, dtype=torch.float64), covariance).std.tolist() == [2.0, 0.0]
