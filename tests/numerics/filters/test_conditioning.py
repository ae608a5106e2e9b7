import pytest
import torch

from torchhand.numerics.filters.conditioning import with_marginal
from torchhand.numerics.filters.gaussian import Gaussian


def _belief(size: int, generator: torch.Generator) -> Gaussian:
    factor = torch.randn(size, size, dtype=torch.float64, generator=generator)
    return Gaussian(
        torch.randn(size, dtype=torch.float64, generator=generator),
        factor @ factor.T + 0.1 * torch.eye(size, dtype=torch.float64),
    )


def test_posterior_of_the_first_numbers_gives_the_kalman_update_of_all():
    generator = torch.Generator().manual_seed(1)
    belief = _belief(7, generator)
    noise = _belief(3, generator).covariance
    measured = torch.randn(3, dtype=torch.float64, generator=generator)
    observe = torch.eye(3, 7, dtype=torch.float64)
    gain = belief.covariance @ observe.T @ torch.linalg.inv(observe @ belief.covariance @ observe.T + noise)
    mean = belief.mean + gain @ (measured - observe @ belief.mean)
    covariance = belief.covariance - gain @ observe @ belief.covariance

    found = with_marginal(belief, mean[:3], covariance[:3, :3])

    torch.testing.assert_close(found.mean, mean)
    torch.testing.assert_close(found.covariance, covariance)


def test_same_distribution_changes_nothing():
    belief = _belief(6, torch.Generator().manual_seed(2))
    found = with_marginal(belief, belief.mean[:2], belief.covariance[:2, :2])
    torch.testing.assert_close(found.mean, belief.mean)
    torch.testing.assert_close(found.covariance, belief.covariance)


def test_singular_belief_is_refused():
    belief = Gaussian(torch.zeros(4, dtype=torch.float64), torch.zeros(4, 4, dtype=torch.float64))
    with pytest.raises(ValueError, match="positive definite"):
        with_marginal(belief, torch.zeros(2, dtype=torch.float64), torch.eye(2, dtype=torch.float64))
