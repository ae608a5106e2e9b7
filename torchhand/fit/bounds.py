"""Bounds of the free parameters of a pose space."""

from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.hand import DOFS, PoseSpace, Skeleton

_ROOT = 6


def free_bounds(space: PoseSpace, skeleton: Skeleton) -> tuple[Float[Tensor, "free"], Float[Tensor, "free"]]:
    """Bounds of the free parameters: each keeps the angle that it is named after within its limits.

    An angle that is tied to another stops at its own limit while the other goes on (the reading of Ouhaddi and Horain
    1998, eq. 4, in which both limits can be reached). Parameters of the root, and those not named after an angle,
    have infinite bounds.
    """
    basis, rows = space.basis, _rows_of(space.free_names).to(space.basis.device)
    factor, constant = basis[rows].diagonal(), space.constant[rows]
    bounds = [
        (torch.nn.functional.pad(limit.to(basis), (_ROOT, 0))[rows] - constant) / factor
        for limit in (skeleton.lower, skeleton.upper)
    ]
    is_bound = (factor != 0) & (rows >= _ROOT)
    lower = torch.where(is_bound, torch.minimum(*bounds), -torch.inf)
    return lower, torch.where(is_bound, torch.maximum(*bounds), torch.inf)


@lru_cache(maxsize=64)
def _rows_of(free_names: tuple[str, ...]) -> Int[Tensor, "free"]:
    """The DOFs that parameters are named after; that of the root's first translation for the others."""
    with torch.inference_mode(False):  # kept for callers in any mode
        return torch.tensor([DOFS.index(name) if name in DOFS else 0 for name in free_names], dtype=torch.long)
