"""The measurement update of a filter in information form: fast when measurements outnumber states."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.numerics.filters.cholesky import robust_cholesky


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
    positive semi-definite by construction. A zero centre row must come with centre_sign 1.
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
        both = torch.linalg.solve(information + signature.diag_embed(), torch.cat([projected, padded], dim=-1))
        solved = both[..., :1]
        shift = padded.mT @ solved
        covariance = padded.mT @ both[..., 1:]
        covariance = 0.5 * (covariance + covariance.mT)
    rest = whitened_innovation - (whitened_spread.mT @ solved).squeeze(-1)
    nis = rest.square().sum(-1) + (signature * solved.squeeze(-1).square()).sum(-1)
    return Correction(shift=shift.squeeze(-1), covariance=covariance, nis=nis)
