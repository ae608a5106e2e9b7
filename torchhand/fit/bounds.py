"""Bounds of the free parameters of a pose space."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.hand import DOFS, PoseSpace, Skeleton

_ROOT = 6


def free_bounds(space: PoseSpace, skeleton: Skeleton) -> tuple[Float[Tensor, "free"], Float[Tensor, "free"]]:
    """Bounds of the free parameters: each keeps the angle that it is named after within its limits.

    An angle that is tied to another stops at its own limit while the other goes on (the reading of Ouhaddi and Horain
    1998, eq. 4, in which both limits can be reached). Parameters of the root, and those not named after an angle,
    have infinite bounds.
    """
    basis = space.basis
    # The DOFs that parameters are named after; that of the root's first translation for the others.
    named = tuple(DOFS.index(name) if name in DOFS else 0 for name in space.free_names)
    rows = constant_tensor(named, torch.long, basis.device)
    factor, constant = basis[rows].diagonal(), space.constant[rows]
    bounds = [
        (torch.nn.functional.pad(limit.to(basis), (_ROOT, 0))[rows] - constant) / factor
        for limit in (skeleton.lower, skeleton.upper)
    ]
    is_bound = (factor != 0) & (rows >= _ROOT)
    lower = torch.where(is_bound, torch.minimum(*bounds), -torch.inf)
    return lower, torch.where(is_bound, torch.maximum(*bounds), torch.inf)
