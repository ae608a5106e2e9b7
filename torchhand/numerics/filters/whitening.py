"""Which measurements a filter can use, and their noise as a square root that whitens residuals and Jacobians."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.numerics.filters.cholesky import robust_cholesky


def wrapped(difference: Float[Tensor, "*batch m"], period: Float[Tensor, "m"]) -> Float[Tensor, "*batch m"]:
    """Differences brought into (-period/2, period/2]; a period > 0, infinite where a measurement does not repeat.

    The direction of a line has period π, an angle 2π.
    """
    is_periodic = period.isfinite()
    length = torch.where(is_periodic, period, 1.0)
    return torch.where(is_periodic, difference - length * (difference / length - 0.5).ceil(), difference)


def usable(
    innovation: Float[Tensor, "*batch m"],
    valid: Bool[Tensor, "*batch m"] | None,
    jacobian: Float[Tensor, "*#batch m k"] | None = None,
) -> Bool[Tensor, "*batch m"]:
    """Which measurements a filter uses: valid ones with a finite innovation and a finite row of the Jacobian.

    A NaN or an infinity, in the measurement or in its prediction, thus counts as a missing measurement, with a gate or
    without one; see also `is_countable`. None for `valid` means that every measurement is.
    """
    finite = innovation.isfinite()
    if jacobian is not None:
        finite = finite & jacobian.isfinite().all(-1)
    return finite if valid is None else finite & valid


def is_countable(
    innovation: Float[Tensor, "*batch m"], variance: Float[Tensor, "*batch m"]
) -> Bool[Tensor, "*batch m"]:
    """Where the innovation's square in units of the noise's variance is a number, with room for what follows.

    That is the sum of all m, and what noise that is correlated as far as the dtype can tell makes of them. What is
    further off (3e11 standard deviations for ten numbers in float32) tells a filter no more than a NaN would.
    """
    limits = torch.finfo(innovation.dtype)
    most = limits.max * limits.eps**2 / (4 * max(1, innovation.shape[-1]))
    return innovation.square() / variance < most


def is_full(noise: Float[Tensor, "..."], innovation: Float[Tensor, "*batch m"]) -> bool:
    """Whether `noise` holds covariances (*batch, m, m) and not variances (*batch, m); dimensions may be 1."""
    size = innovation.shape[-1]
    full = noise.ndim == innovation.ndim + 1
    if noise.ndim not in (innovation.ndim, innovation.ndim + 1) or noise.shape[-1 - full :] != (size,) * (1 + full):
        raise ValueError(
            f"noise must be variances (*batch, {size}) or covariances (*batch, {size}, {size}) with the batch"
            f" {tuple(innovation.shape[:-1])}, got shape {tuple(noise.shape)}"
        )
    return full


def masked_noise(
    noise: Float[Tensor, "..."], used: Bool[Tensor, "*batch m"], innovation: Float[Tensor, "*batch m"]
) -> Float[Tensor, "..."]:
    """The noise with a unit variance, uncorrelated with all others, where a measurement is left out.

    With a zero innovation and a zero row of the Jacobian this is the same as deleting the measurement, correlated noise
    included. Raises ValueError where a used measurement's variance is not above 0.
    """
    full = is_full(noise, innovation)
    variance = noise.diagonal(dim1=-2, dim2=-1) if full else noise
    if not bool(((variance > 0) | ~used).all()):
        raise ValueError("noise must be above 0 wherever a measurement is valid, got 0, a negative number or NaN")
    if not full:
        return torch.where(used, noise, 1.0)
    identity = torch.eye(innovation.shape[-1], dtype=noise.dtype, device=noise.device)
    return torch.where(used.unsqueeze(-1) & used.unsqueeze(-2), noise, identity)


def noise_root(noise: Float[Tensor, "..."], *, full: bool) -> Float[Tensor, "..."]:
    """Standard deviations, or the lower Cholesky factor of covariances."""
    return robust_cholesky(noise) if full else noise.sqrt()


def whiten(
    root: Float[Tensor, "..."], rows: Float[Tensor, "*batch m columns"], *, full: bool
) -> Float[Tensor, "*batch m columns"]:
    """root⁻¹ rows: residuals and Jacobians in units of the noise, which is then the identity."""
    if not full:
        return rows / root.unsqueeze(-1)
    batch = torch.broadcast_shapes(root.shape[:-2], rows.shape[:-2])
    return torch.linalg.solve_triangular(root.expand(*batch, *root.shape[-2:]), rows, upper=False)
