"""A Cholesky factor that rounding cannot break, and covariances that rounding has broken mended."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.precision import full_precision

RELATIVE_JITTERS = (1e-10, 1e-8, 1e-6)  # times the diagonal
RELATIVE_EIGENVALUE_FLOOR = 1e-12  # times the largest eigenvalue


@full_precision
def robust_cholesky(matrix: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch n n"]:
    """Lower triangular L with L Lᵀ = matrix, or nearly so where the matrix is not positive definite.

    The symmetric part is factored as it is. Only those matrices of the batch that fail are tried again, with a growing
    share of their own diagonal added, which suits states whose numbers have different units, and at last with their
    eigenvalues clipped from below, so one bad matrix changes no other. A matrix of zeros gives zeros. A matrix with a
    NaN or an infinity gives NaN: one lost filter of a batch does not stop the others. Differentiable; at a clipped
    matrix only in directions that keep it so.
    """
    symmetric = 0.5 * (matrix + matrix.mT)
    factor, info = torch.linalg.cholesky_ex(symmetric)
    if not bool(info.any()):
        return factor
    size = matrix.shape[-1]
    flat = symmetric.reshape(-1, size, size)
    failed = info.reshape(-1).nonzero().squeeze(-1)
    repaired = torch.stack([_factor_one(one) for one in flat[failed]])
    return factor.reshape(-1, size, size).index_copy(0, failed, repaired).reshape(matrix.shape)


def semidefinite(matrix: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch n n"]:
    """The matrix itself where it is positive definite, else the positive semi-definite one next to it.

    Both in units of the diagonal, so that a state with small numbers is changed no more than the others; a row whose
    diagonal is not above 0 becomes 0. Symmetric where the matrix is. A matrix with a NaN or an infinity stays as it is.
    The gradient is that of the matrix.
    """
    failed = torch.linalg.cholesky_ex(matrix.detach()).info != 0
    failed = failed & matrix.detach().isfinite().all(-1).all(-1)
    if not bool(failed.any()):
        return matrix
    size = matrix.shape[-1]
    rows = failed.reshape(-1).nonzero().squeeze(-1)
    broken = matrix.detach().reshape(-1, size, size)[rows]
    deviation = broken.diagonal(dim1=-2, dim2=-1).clamp_min(0.0).sqrt()
    unit = torch.where(deviation > 0, deviation.reciprocal(), 0.0)
    unit = torch.where(unit.isfinite(), unit, 0.0)
    values, vectors = torch.linalg.eigh(unit[:, :, None] * broken * unit[:, None, :])
    root = deviation[:, :, None] * vectors * values.clamp_min(0.0).sqrt()[:, None, :]
    mended = root @ root.mT
    change = torch.zeros_like(matrix).detach().reshape(-1, size, size)
    change = change.index_copy(0, rows, 0.5 * (mended + mended.mT) - broken).reshape(matrix.shape)
    return matrix + change


def _factor_one(symmetric: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """Factor of one matrix that plain Cholesky refused."""
    if not bool(symmetric.isfinite().all()):
        return torch.full_like(symmetric, torch.nan)
    diagonal = symmetric.diagonal().clamp_min(0.0).diag()
    for jitter in RELATIVE_JITTERS:
        factor, info = torch.linalg.cholesky_ex(symmetric + jitter * diagonal)
        if not bool(info):
            return factor
    values, vectors = torch.linalg.eigh(symmetric)
    largest = values[-1].clamp_min(0.0)
    root = vectors * torch.maximum(values, RELATIVE_EIGENVALUE_FLOOR * largest).sqrt()
    upper = torch.linalg.qr(root.mT).R
    return (upper * torch.where(upper.diagonal() < 0, -1.0, 1.0).unsqueeze(-1)).mT.tril()
