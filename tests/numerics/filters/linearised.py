"""Values and Jacobians of a function by automatic differentiation: what the filters are told in these tests."""

from collections.abc import Callable

import torch
from torch import Tensor

from torchhand.numerics import Linearised


def linearised(function: Callable[[Tensor], Tensor]) -> Linearised:
    """A differentiable function of states (n, k) -> (n, m), row by row, with the Jacobian that autograd gives."""

    def both(states: Tensor) -> tuple[Tensor, Tensor]:
        flat = states.reshape(-1, states.shape[-1])

        def of_one(state: Tensor) -> tuple[Tensor, Tensor]:
            value = function(state.unsqueeze(0)).squeeze(0)
            return value, value

        jacobian, value = torch.func.vmap(torch.func.jacrev(of_one, has_aux=True))(flat)
        batch = states.shape[:-1]
        return value.reshape(*batch, -1), jacobian.reshape(*batch, *jacobian.shape[-2:])

    return both
