import filterpy.kalman
import pytest
import torch

from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.numerics.filters.sigma import UnscentedSettings, sigma_points

EXACT = [
    UnscentedSettings(),
    UnscentedSettings(alpha=1e-3, kappa=1.0),
    UnscentedSettings(beta=0.0, kappa=-2.0),
    UnscentedSettings(variant="kappa"),
    UnscentedSettings(variant="julier95"),
]


def random_state(*batch: int, size: int = 5, seed: int = 0) -> Gaussian:
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(*batch, size, size, generator=generator, dtype=torch.float64)
    mean = torch.randn(*batch, size, generator=generator, dtype=torch.float64)
    return Gaussian(mean, root @ root.mT / size + 0.1 * torch.eye(size, dtype=torch.float64))


def moments(state: Gaussian, settings: UnscentedSettings) -> tuple[torch.Tensor, torch.Tensor]:
    points, mean_weights, covariance_weights = sigma_points(state, settings)
    deviation = points - state.mean.unsqueeze(-2)
    return mean_weights @ points, (deviation.mT * covariance_weights) @ deviation


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
@pytest.mark.parametrize("settings", EXACT, ids=str)
def test_exact_sets_have_the_moments_of_the_gaussian(settings: UnscentedSettings, batch: tuple[int, ...]) -> None:
    state = random_state(*batch)
    mean, covariance = moments(state, settings)
    rounding = 1e-15 * 2 * 5 * float(sigma_points(state, settings).mean_weights.abs().max() + 1)
    assert torch.allclose(mean, state.mean, rtol=0, atol=10 * rounding)
    assert torch.allclose(covariance, state.covariance, rtol=0, atol=1e-9 if settings.alpha < 1 else 1e-13)


@pytest.mark.parametrize("size", [9, 81])
def test_the_printed_set_is_too_narrow_by_2n_over_2n_plus_1(size: int) -> None:
    state = random_state(size=size)
    mean, covariance = moments(state, UnscentedSettings(variant="paper"))
    assert torch.allclose(mean, state.mean, rtol=0, atol=1e-13)
    assert torch.allclose(covariance, 2 * size / (2 * size + 1) * state.covariance, rtol=0, atol=1e-13)


def test_points_and_weights_match_filterpy() -> None:
    state = random_state()
    for theirs, ours in (
        (filterpy.kalman.MerweScaledSigmaPoints(5, 0.3, 2.0, 1.0), UnscentedSettings(alpha=0.3, kappa=1.0)),
        (filterpy.kalman.JulierSigmaPoints(5, -2.0), UnscentedSettings(beta=0.0, kappa=-2.0)),
    ):
        points, mean_weights, covariance_weights = sigma_points(state, ours)
        expected = torch.from_numpy(theirs.sigma_points(state.mean.numpy(), state.covariance.numpy()))
        assert torch.allclose(points, expected, rtol=0, atol=1e-13)
        assert torch.allclose(mean_weights, torch.from_numpy(theirs.Wm), rtol=1e-13, atol=1e-13)
        assert torch.allclose(covariance_weights, torch.from_numpy(theirs.Wc), rtol=1e-13, atol=1e-13)


def test_a_known_state_has_all_its_points_in_one_place() -> None:
    state = Gaussian(torch.ones(3, dtype=torch.float64), torch.zeros(3, 3, dtype=torch.float64))
    assert torch.equal(sigma_points(state, UnscentedSettings()).points, torch.ones(7, 3, dtype=torch.float64))


def test_settings_are_checked() -> None:
    with pytest.raises((ValueError, TypeError), match=r"(?s)variant.*merwe"):  # TypeError: from the hook
        UnscentedSettings(variant="merwe")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"alpha must be above 0, got 0\.0"):
        UnscentedSettings(alpha=0.0)
    with pytest.raises(ValueError, match="beta must be finite, got nan"):
        UnscentedSettings(beta=float("nan"))
    with pytest.raises(ValueError, match=r"kappa must be above -5 for a state of 5 numbers, got -5\.0"):
        sigma_points(random_state(), UnscentedSettings(kappa=-5.0))
