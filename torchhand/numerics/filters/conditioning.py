"""A belief whose first numbers are known better, by something else than a linear measurement."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.precision import full_precision


@full_precision
def with_marginal(belief: Gaussian, mean: Float[Tensor, "k"], covariance: Float[Tensor, "k k"]) -> Gaussian:
    """The belief of n numbers when the first k of them turn out to be distributed otherwise (Jeffrey's rule).

    What the others are, given the first, stays as it was: rates follow the positions that an optimiser found. Exact
    where the new distribution is the posterior that used the old one of these numbers as its prior.

    Raises ValueError where the belief has no covariance of full rank in them.
    """
    k = len(mean)
    known, cross = belief.covariance[:k, :k], belief.covariance[k:, :k]
    factor, info = torch.linalg.cholesky_ex(known)
    if int(info):
        raise ValueError("belief: expected a positive definite covariance of the first numbers")
    gain = torch.cholesky_solve(cross.mT, factor).mT
    rest = belief.mean[k:] + gain @ (mean - belief.mean[:k])
    moved = gain @ covariance
    other = belief.covariance[k:, k:] + gain @ (covariance - known) @ gain.mT
    top = torch.cat((covariance, moved.mT), 1)
    whole = torch.cat((top, torch.cat((moved, other), 1)), 0)
    return Gaussian(torch.cat((mean, rest)), 0.5 * (whole + whole.mT))
