"""Noise that a filter learns while it runs: the adaptive filter that Ouhaddi and Horain (1998, 7.5) announce.

After every frame the filter says what it believes of the noise that it has just met: the measurement noise from the
residual, the process noise from the innovation. Exponential forgetting averages these samples, and bounds relative to
the nominal noise keep a run of luck, or of gross errors, from taking the filter over.

One of the two kinds can be learned to its true value while the other is known. Both at once settle where innovations
are as large as the filter expects (NIS = m), but not necessarily at the true split between the two: that is not
contained in single innovations.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.numerics.filters.cholesky import robust_cholesky
from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.numerics.filters.motion import MotionModel


@dataclass(frozen=True, kw_only=True)
class AdaptiveNoiseSettings:
    """How fast noise is learned, and how far it may go."""

    forgetting: float = 0.97
    """ρ, the share of the old estimate that is kept per frame; above 0, below 1. 0.97 averages some 30 frames."""
    floor: float = 0.05
    """Least noise relative to the nominal one (variances); above 0."""
    ceiling: float = 20.0
    """Most noise relative to the nominal one; at least the floor, finite."""

    def __post_init__(self) -> None:
        if not 0 < self.forgetting < 1:
            raise ValueError(f"adaptive.forgetting: expected above 0 and below 1, got {self.forgetting!r}")
        if not self.floor > 0:
            raise ValueError(f"adaptive.floor: expected above 0, got {self.floor!r}")
        if not self.floor <= self.ceiling < float("inf"):
            raise ValueError(
                f"adaptive.ceiling: expected finite and at least the floor {self.floor!r}, got {self.ceiling!r}"
            )


DEFAULT_SETTINGS = AdaptiveNoiseSettings()


def residual_covariance(
    residual: Float[Tensor, "*batch m"], jacobian: Float[Tensor, "*#batch m k"], updated: Gaussian
) -> Float[Tensor, "*batch m m"]:
    """ε εᵀ + H P Hᵀ: what one frame says of the measurement noise's covariance R, positive semi-definite.

    residual: measurement minus its prediction from the *updated* state; jacobian: there, in the first k components.
    """
    columns = jacobian.shape[-1]
    spread = jacobian @ updated.covariance[..., :columns, :columns] @ jacobian.mT
    return residual.unsqueeze(-1) * residual.unsqueeze(-2) + 0.5 * (spread + spread.mT)


def residual_variance(
    residual: Float[Tensor, "*batch m"], jacobian: Float[Tensor, "*#batch m k"], updated: Gaussian
) -> Float[Tensor, "*batch m"]:
    """The diagonal of `residual_covariance`, without the rest. Divide it by the frame's own nominal variances to learn
    factors of a noise that changes from frame to frame."""
    columns = jacobian.shape[-1]
    spread = (jacobian @ updated.covariance[..., :columns, :columns] * jacobian).sum(-1)
    return residual.square() + spread


def gain_covariance(predicted: Gaussian, updated: Gaussian) -> Float[Tensor, "*batch n n"]:
    """G ν νᵀ Gᵀ, the plain sample of the process noise Q: the square of the correction, never negative.

    Its mean is P⁻ - P⁺: the noise of a random walk in its steady state, but not of a model with velocities, and not
    while the filter settles or misses measurements. `process_covariance` has none of these faults.
    """
    shift = updated.mean - predicted.mean
    return shift.unsqueeze(-1) * shift.unsqueeze(-2)


def process_covariance(
    predicted: Gaussian, updated: Gaussian, process_noise: Float[Tensor, "*#batch n n"]
) -> Float[Tensor, "*batch n n"]:
    """Q + G (ν νᵀ - S) Gᵀ = Q + shift shiftᵀ - (P⁻ - P⁺): what one frame says of the process noise just added.

    Its mean is Q where Q is true, for any motion model and any pattern of missing measurements; where corrections are
    larger than the filter expects, it is more. Without a measurement it is Q and nothing is learned. One sample may be
    indefinite: the average, and the bounds of `adapted_variance` and `adapted_covariance`, are what is used.
    """
    expected = predicted.covariance - updated.covariance
    return process_noise + gain_covariance(predicted, updated) - expected


def noise_density(
    process_noise: Float[Tensor, "*batch n n"], model: MotionModel, dt_s: float
) -> Float[Tensor, "*batch dofs"]:
    """The density per degree of freedom whose `MotionModel.process_noise` has such variances in its last block.

    A few numbers instead of n², which stay right when the frame rate changes. The noise drives the last derivative; in
    the blocks before it, what a step adds is hardly more than nothing beside the scatter of a sample.
    """
    blocks = model.order + 1
    size = process_noise.shape[-1]
    if size % blocks:
        raise ValueError(
            f"process_noise must be for a multiple of {blocks} numbers, which order {model.order} needs, got {size}"
        )
    unit = model.process_noise(dt_s, process_noise.new_ones(1))[-1, -1]
    return process_noise.diagonal(dim1=-2, dim2=-1)[..., size - size // blocks :] / unit


def adapted_variance(
    estimate: Float[Tensor, "*batch m"],
    sample: Float[Tensor, "*batch m"],
    nominal: Float[Tensor, "*#batch m"],
    settings: AdaptiveNoiseSettings = DEFAULT_SETTINGS,
    *,
    used: Bool[Tensor, "*batch m"] | None = None,
) -> Float[Tensor, "*batch m"]:
    """ρ estimate + (1 - ρ) sample within [floor, ceiling] · nominal; for variances, densities and factors alike.

    used: False where there is nothing to learn from. Samples that are no finite number teach nothing either. To leave
    out what a gate has rejected makes the noise look smaller than it is.
    """
    is_known = sample.isfinite() if used is None else used & sample.isfinite()
    mixed = settings.forgetting * estimate + (1 - settings.forgetting) * torch.where(is_known, sample, 0.0)
    mixed = torch.where(is_known, mixed, estimate)
    return torch.minimum(torch.maximum(mixed, settings.floor * nominal), settings.ceiling * nominal)


def adapted_covariance(
    estimate: Float[Tensor, "*batch m m"],
    sample: Float[Tensor, "*batch m m"],
    nominal: Float[Tensor, "*#batch m m"],
    settings: AdaptiveNoiseSettings = DEFAULT_SETTINGS,
    *,
    used: Bool[Tensor, "*batch m"] | None = None,
) -> Float[Tensor, "*batch m m"]:
    """`adapted_variance` for full matrices, positive definite whenever the nominal one is.

    floor · nominal <= result <= ceiling · nominal in every direction: the bounds hold for the eigenvalues relative to
    the nominal noise, so units do not matter. Rows and columns of measurements that are not used keep their values;
    their covariances with used ones fade by √ρ, which keeps the matrix definite.
    """
    is_known = sample.isfinite().all(-1).all(-1, keepdim=True).expand(sample.shape[:-1])
    if used is not None:
        inside = used.unsqueeze(-1) & used.unsqueeze(-2)
        sample = torch.where(inside, sample, 0.0)
        is_known = used & sample.isfinite().all(-1).all(-1, keepdim=True)
    root_of_fraction = estimate.new_tensor(settings.forgetting).sqrt()  # in the estimate's precision
    keep = torch.where(is_known, root_of_fraction, 1.0)
    inside = is_known.unsqueeze(-1) & is_known.unsqueeze(-2)
    learned = (1 - settings.forgetting) * torch.where(inside, sample, 0.0)
    mixed = keep.unsqueeze(-1) * estimate * keep.unsqueeze(-2) + learned

    root = robust_cholesky(nominal).expand_as(mixed)
    relative = torch.linalg.solve_triangular(root, mixed, upper=False)
    relative = torch.linalg.solve_triangular(root, relative.mT, upper=False)
    values, vectors = torch.linalg.eigh(0.5 * (relative + relative.mT))
    bounded = (vectors * values.clamp(settings.floor, settings.ceiling).unsqueeze(-2)) @ vectors.mT
    result = root @ bounded @ root.mT
    return 0.5 * (result + result.mT)
