"""Noise that a filter learns while it runs: the adaptive filter that Ouhaddi and Horain (1998, 7.5) announce.

After every frame the innovation says what the filter should believe of the process noise that it has just met.
Exponential forgetting averages these samples, and bounds relative to the nominal noise keep a run of luck, or of gross
errors, from taking the filter over.

Process noise is learned to its true value while the measurement noise is known: single innovations do not tell how to
split what they have too much between the two.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.numerics.filters.gaussian import Gaussian
from torchhand.numerics.filters.motion import MotionModel
from torchhand.precision import full_precision


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


@full_precision
def gain_covariance(predicted: Gaussian, updated: Gaussian) -> Float[Tensor, "*batch n n"]:
    """G ν νᵀ Gᵀ, the plain sample of the process noise Q: the square of the correction, never negative.

    Its mean is P⁻ - P⁺: the noise of a random walk in its steady state, but not of a model with velocities, and not
    while the filter settles or misses measurements. `process_covariance` has none of these faults.
    """
    shift = updated.mean - predicted.mean
    return shift.unsqueeze(-1) * shift.unsqueeze(-2)


@full_precision
def process_covariance(
    predicted: Gaussian, updated: Gaussian, process_noise: Float[Tensor, "*#batch n n"]
) -> Float[Tensor, "*batch n n"]:
    """Q + G (ν νᵀ - S) Gᵀ = Q + shift shiftᵀ - (P⁻ - P⁺): what one frame says of the process noise just added.

    Its mean is Q where Q is true, for any motion model and any pattern of missing measurements; where corrections are
    larger than the filter expects, it is more. Without a measurement it is Q and nothing is learned. One sample may be
    indefinite: the average, and the bounds of `adapted_variance`, are what is used.
    """
    expected = predicted.covariance - updated.covariance
    return process_noise + gain_covariance(predicted, updated) - expected


@full_precision
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


@full_precision
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
