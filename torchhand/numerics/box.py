"""The likeliest state of a Gaussian inside a box: what a filter that knows no limits becomes where there are some."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.devices import asks_after, is_host, read_back
from torchhand.numerics.filters import Gaussian
from torchhand.precision import full_precision

_MAX_ROUNDS = 3  # times the number of variables; each round changes at least one


@full_precision
def mode_in_box(
    state: Gaussian, lower: Float[Tensor, "*#batch n"], upper: Float[Tensor, "*#batch n"]
) -> tuple[Float[Tensor, "*batch n"], Bool[Tensor, "*batch n"]]:
    """The x nearest to the mean in the metric of the covariance with lower <= x <= upper, and which bounds it lies on.

    To clamp variable by variable moves some and leaves those that are correlated with them, so that what was measured
    of them together no longer holds; here the others follow (the projection of Simon and Chia 2002, with inequalities
    by an active set: x = μ + P_a P_aa⁻¹ (b - μ_a)). Bounds may be infinite; lower <= upper is meant. The covariance
    must be positive definite.
    """
    mean, covariance = state.mean, state.covariance
    lower, upper = lower.expand(mean.shape), upper.expand(mean.shape)
    below, above = mean < lower, mean > upper
    value = mean
    for turn in range(_MAX_ROUNDS * mean.shape[-1]):
        is_bound = below | above
        if asks_after(turn, mean.device) and not read_back(is_bound).any():
            break
        missing = torch.where(is_bound, torch.where(below, lower, upper) - mean, 0.0)
        pull = _pull(covariance, missing, is_bound)
        value = mean + (covariance @ pull.unsqueeze(-1)).squeeze(-1)
        is_needed = torch.where(below, pull > 0, pull < 0)
        leads_below, leads_above = ~is_bound & (value < lower), ~is_bound & (value > upper)
        changes = leads_below | leads_above | (is_bound & ~is_needed)
        if asks_after(turn, mean.device) and not read_back(changes).any():
            break
        below, above = (below & is_needed) | leads_below, (above & is_needed) | leads_above
    is_bound = below | above
    return torch.where(is_bound, torch.where(below, lower, upper), value).clamp(lower, upper), is_bound


def _pull(covariance: Tensor, missing: Tensor, is_bound: Tensor) -> Tensor:
    """P_aa⁻¹ (b - μ_a) at the variables on their bounds, 0 at the others."""
    if is_bound.ndim == 1 and is_host(is_bound.device):  # few of many: their own system alone
        bound = is_bound.nonzero().squeeze(-1)
        own = covariance.index_select(0, bound).index_select(1, bound)
        return torch.zeros_like(missing).index_copy(0, bound, torch.linalg.solve(own, missing.index_select(0, bound)))
    kept = is_bound.to(missing)
    matrix = covariance * kept.unsqueeze(-1) * kept.unsqueeze(-2) + (1 - kept).diag_embed()
    if is_host(is_bound.device):
        return torch.linalg.solve(matrix, missing)
    return torch.linalg.solve_ex(matrix, missing).result  # does not ask whether a matrix was singular
