"""The extended Kalman filter's measurement update, linearised once, batched over independent filters.

`iterated.py` repeats the linearisation; `unscented.py` is the filter that needs no Jacobian.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.numerics.filters.cholesky import robust_cholesky
from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.numerics.filters.square_root import PosteriorRoot
from torchhand.numerics.filters.unscented import Update
from torchhand.numerics.filters.whitening import is_countable, is_full, masked_noise, noise_root, usable, whiten
from torchhand.precision import full_precision

Linearised = Callable[[Tensor], tuple[Tensor, Tensor]]
"""A function of states (*batch, k) that returns values (*batch, m) and their Jacobian (*batch, m, k)."""


@full_precision
def update_extended(
    state: Gaussian,
    innovation: Float[Tensor, "*batch m"],
    jacobian: Float[Tensor, "*#batch m k"],
    noise: Float[Tensor, "..."],
    *,
    valid: Bool[Tensor, "*batch m"] | None = None,
    gate: float | None = None,
    group: int = 1,
) -> Update:
    """Measurement update x + K ν and P - K S Kᵀ, in square-root form.

    With P = L Lᵀ and B = R^(-1/2) H L the posterior is L (I + BᵀB)⁻¹ Lᵀ, its factor taken from B itself
    (`PosteriorRoot`). It is symmetric, and positive semi-definite up to the rounding of that one product, however close
    to singular the prior is and however small the noise. Cost: O((m + k) k² + n³).

    innovation   measurement minus prediction; differences of angles through `wrapped` first
    jacobian     of the prediction in the first k components of the state, k <= n: positions are observed, not rates
    noise        variances (*batch, m) of independent noises, or covariances (*batch, m, m); leading dimensions may be 1
    valid        False leaves a measurement out; whatever number or NaN stands there has no effect. A measurement whose
                 innovation or row of the Jacobian is not finite, or whose innovation is too large for its square, is
                 left out as well
    gate         leaves out each group with νᵀ S⁻¹ ν > gate, S the group's own block: 9 for three sigma of a group of 1
    group        measurements in a row that are judged together; the whole vector has a multiple of it

    A filter without any used measurement comes back unchanged. Differentiable in everything but the choice of the gate.
    """
    root = robust_cholesky(state.covariance)
    innovation, rows, variance, used = masked_and_gated(
        root, innovation, jacobian, noise, valid=valid, gate=gate, group=group
    )
    both = torch.where(used.unsqueeze(-1), torch.cat((innovation.unsqueeze(-1), rows), -1), 0.0)
    full = is_full(noise, innovation)
    both = whiten(noise_root(masked_noise(noise, used, innovation), full=full), both, full=full)
    kept, rows = both[..., 0], both[..., 1:]

    left = PosteriorRoot.of(rows)
    offset, _ = left.step(kept)
    # The lower triangle of L keeps what is not observed out of the sums: those columns only come back unchanged.
    seen, hidden = root[..., : rows.shape[-1]], root[..., rows.shape[-1] :]
    shift = (seen @ offset.unsqueeze(-1)).squeeze(-1)
    covariance = left.covariance(seen) + hidden @ hidden.mT
    nis = offset.square().sum(-1) + (kept - (rows @ offset.unsqueeze(-1)).squeeze(-1)).square().sum(-1)
    count = used.sum(-1)
    has_any = (count > 0).unsqueeze(-1)
    posterior = Gaussian(
        torch.where(has_any, state.mean + shift, state.mean),
        torch.where(has_any.unsqueeze(-1), _symmetric(covariance), state.covariance),
    )
    return Update(state=posterior, innovation=innovation, innovation_variance=variance, used=used, nis=nis, count=count)


def masked_and_gated(
    root: Float[Tensor, "*batch n n"],
    innovation: Float[Tensor, "*batch m"],
    jacobian: Float[Tensor, "*#batch m k"],
    noise: Float[Tensor, "..."],
    *,
    valid: Bool[Tensor, "*batch m"] | None,
    gate: float | None,
    group: int,
) -> tuple[Float[Tensor, "*batch m"], Float[Tensor, "*batch m k"], Float[Tensor, "*batch m"], Bool[Tensor, "*batch m"]]:
    """Which measurements are used, and what of them does not depend on that.

    `root` is the lower triangular square root of the prior's covariance, the other arguments are those of
    `update_extended`. Returns the innovation and the Jacobian in units of the prior, H L, with zeros where a
    measurement cannot be used; the innovation's variance, infinite there; and what is used: valid, finite and inside
    the gate.
    """
    size, columns = jacobian.shape[-2:]
    if not 1 <= columns <= root.shape[-1]:
        raise ValueError(f"jacobian must have 1 to {root.shape[-1]} columns, got {columns}")
    if gate is not None and not gate > 0:
        raise ValueError(f"gate must be None or above 0, got {gate!r}")
    if group < 1 or size % group:
        raise ValueError(f"group must divide the {size} measurements, got {group!r}")
    valid = usable(innovation, valid, jacobian)
    rows = torch.where(valid.unsqueeze(-1), jacobian, 0.0) @ root[..., :columns, :columns]
    innovation = torch.where(valid, innovation, 0.0)
    full, noise = is_full(noise, innovation), masked_noise(noise, valid, innovation)
    valid = valid & is_countable(innovation, noise.diagonal(dim1=-2, dim2=-1) if full else noise)
    innovation, rows = torch.where(valid, innovation, 0.0), torch.where(valid.unsqueeze(-1), rows, 0.0)
    noise = masked_noise(noise, valid, innovation)
    variance = rows.square().sum(-1) + (noise.diagonal(dim1=-2, dim2=-1) if full else noise)
    used = valid
    if gate is not None:
        with torch.no_grad():
            used = valid & (_group_nis(innovation, rows, noise, group, full=full) <= gate)
    return innovation, rows, torch.where(valid, variance, torch.inf), used


def _group_nis(innovation: Tensor, rows: Tensor, noise: Tensor, group: int, *, full: bool) -> Tensor:
    """νᵀ S⁻¹ ν of every measurement's group: (*batch, m)."""
    grouped_rows = rows.unflatten(-2, (-1, group))
    if full:
        blocks = noise.unflatten(-1, (-1, group)).unflatten(-3, (-1, group))  # groups, group, groups, group
        own = blocks.diagonal(dim1=-4, dim2=-2).movedim(-1, -3)
    else:
        own = noise.unflatten(-1, (-1, group)).diag_embed()
    factor = robust_cholesky(grouped_rows @ grouped_rows.mT + own)
    grouped = innovation.unflatten(-1, (-1, group)).unsqueeze(-1)
    nis = torch.linalg.solve_triangular(factor, grouped, upper=False).square().sum((-2, -1))
    return nis.repeat_interleave(group, -1)


def _symmetric(matrix: Tensor) -> Tensor:
    return 0.5 * (matrix + matrix.mT)
