"""The measurement update of a filter in information form: fast when measurements outnumber states."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.numerics.filters.cholesky import robust_cholesky, semidefinite
from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.precision import full_precision


@dataclass(frozen=True, kw_only=True)
class Correction:
    """What the measurements add to a prior."""

    shift: Float[Tensor, "*batch n"]  # posterior mean minus prior mean
    covariance: Float[Tensor, "*batch n n"]  # posterior covariance of the correlated part
    nis: Float[Tensor, "*batch"]  # νᵀ S⁻¹ ν


def correct(
    state_spread: Float[Tensor, "*batch n a"],
    whitened_spread: Float[Tensor, "*batch p m"],
    whitened_innovation: Float[Tensor, "*batch m"],
    centre_sign: float = 1.0,
) -> Correction:
    """Kalman correction from square roots, without forming the m x m innovation covariance S.

    Rows of `whitened_spread` are Eᵀ R^(-1/2) and `whitened_innovation` is R^(-1/2) ν, for diagonal R; a measurement
    left out has a zero column. `state_spread` A belongs to the last a of the p rows, the others are uncorrelated
    with the state. With J = diag(centre_sign, 1, ..., 1), S = R + E J Eᵀ, the cross covariance A J Eᵀ and
    G = Eᵀ R⁻¹ E, Woodbury's identity gives (A padded with zeros to p columns)

        shift = A y,   posterior = P - A J Aᵀ + A (J + G)⁻¹ Aᵀ,   NIS = |ν' - R^(-1/2) E y|² + yᵀ J y

    with y = (J + G)⁻¹ Eᵀ R⁻¹ ν and ν' = R^(-1/2) ν. The sum of squares stays exact where the state explains nearly all
    of a large innovation; the shorter ν'ᵀν' - νᵀ R⁻¹ E y is then a difference of large numbers, negative at times.
    Only the last term of the posterior is returned; where A J Aᵀ = P it is all of it, and for centre_sign = 1 it is
    positive semi-definite by construction. For centre_sign = -1, S has to be positive definite: `is_bearable_centre`.
    """
    information = whitened_spread @ whitened_spread.mT
    projected = whitened_spread @ whitened_innovation.unsqueeze(-1)
    rows, correlated = information.shape[-1], state_spread.shape[-1]
    signature = torch.ones(rows, dtype=information.dtype, device=information.device)
    if centre_sign > 0:
        factor = robust_cholesky(information + signature.diag_embed())
        half = torch.linalg.solve_triangular(factor, projected, upper=False)
        solved = torch.linalg.solve_triangular(factor.mT, half, upper=True)
        # The last block of the inverse is the inverse of the last block of the factor times its transpose.
        last = factor[..., rows - correlated :, rows - correlated :]
        root = torch.linalg.solve_triangular(last, state_spread.mT, upper=False)
        shift = root.mT @ half[..., rows - correlated :, :]
        covariance = root.mT @ root
    else:
        signature[0] = -1.0
        padded = torch.nn.functional.pad(state_spread, (rows - correlated, 0)).mT
        factor, own, pivot = _without_centre(information)
        both = torch.cat([projected[..., 1:, :], padded[..., 1:, :]], dim=-1)
        seen, root = torch.linalg.solve_triangular(factor, both, upper=False).tensor_split((1,), dim=-1)
        centre = (projected[..., :1, :] - own.mT @ seen) / pivot
        others = torch.linalg.solve_triangular(factor.mT, seen - own @ centre, upper=True)
        solved = torch.cat([centre, others], dim=-2)
        shift = padded.mT @ solved
        taken = padded[..., :1, :] - own.mT @ root
        covariance = semidefinite(root.mT @ root + taken.mT @ taken / pivot)
    rest = whitened_innovation - (whitened_spread.mT @ solved).squeeze(-1)
    nis = (rest.square().sum(-1) + (signature * solved.squeeze(-1).square()).sum(-1)).clamp_min(0.0)
    return Correction(shift=shift.squeeze(-1), covariance=covariance, nis=nis)


@full_precision
def update_quadratic(
    state: Gaussian, gradient: Float[Tensor, "*batch k"], matrix: Float[Tensor, "*batch k k"]
) -> Gaussian:
    """The belief after observations whose cost is gradient · d + ½ dᵀ matrix d, d the change of the first k numbers.

    matrix: symmetric and positive semi-definite; what it does not tell may be singular. With P = R Rᵀ, R lower
    triangular, A its first k columns and L the first k rows of these, the mean changes by -A (I + LᵀML)⁻¹ Lᵀ gradient,
    and the covariance is A (I + LᵀML)⁻¹ Aᵀ + R_h R_hᵀ, R_h the other columns: positive semi-definite by construction.
    That is `update_extended` with √M as Jacobian, without that root. Numbers that are not finite tell nothing.
    """
    size = gradient.shape[-1]
    root = robust_cholesky(state.covariance)
    seen, hidden, own = root[..., :size], root[..., size:], root[..., :size, :size]
    information = own.mT @ matrix @ own
    pull = own.mT @ gradient.unsqueeze(-1)
    is_told = (information.isfinite().all(-1) & pull.isfinite().all(-1)).all(-1)
    if not bool(is_told.all()):
        information = torch.where(is_told[..., None, None], information, 0.0)
        pull = torch.where(is_told[..., None, None], pull, 0.0)
    factor = robust_cholesky(information + torch.eye(size, dtype=root.dtype, device=root.device))
    half = torch.linalg.solve_triangular(factor, torch.cat((seen.mT, pull), -1), upper=False)
    half, pull = half[..., :-1], half[..., -1:]
    covariance = half.mT @ half + hidden @ hidden.mT
    return Gaussian(state.mean - (half.mT @ pull).squeeze(-1), covariance)


def is_bearable_centre(whitened_spread: Float[Tensor, "*batch p m"]) -> Bool[Tensor, "*batch"]:
    """Whether S is positive definite though the centre, the first row, counts negative: arguments of `correct`."""
    information = whitened_spread @ whitened_spread.mT
    _, _, pivot = _without_centre(information.detach())
    margin = 8 * torch.finfo(information.dtype).eps * (1 + information[..., 0, 0])
    return pivot[..., 0, 0] < -margin


def _without_centre(information: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Factor of J + G but its first row and column, what of these it explains, and the pivot that is left, below 0."""
    identity = torch.eye(information.shape[-1] - 1, dtype=information.dtype, device=information.device)
    factor = robust_cholesky(information[..., 1:, 1:] + identity)
    own = torch.linalg.solve_triangular(factor, information[..., 1:, :1], upper=False)
    return factor, own, information[..., :1, :1] - 1.0 - own.mT @ own
