"""Normal distributions cut off at two limits: density and sampling that hold in the far tails."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.precision import own_precision

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)
_TAIL = 30.0
"""Deviations beyond which a tail counts as exponential: its quantile is good to 1e-3 of its own width there."""


@own_precision
def log_ndtr(value: Float[Tensor, "*sizes"]) -> Float[Tensor, "*sizes"]:
    """log Φ, the standard normal's distribution function, to full relative precision; differentiable twice and more.

    `torch.special.log_ndtr` in parts that `torch.func.vmap` and `torch.compile` know.
    """
    is_left = value < -1
    left = torch.where(is_left, value, -1.0)
    right = torch.where(is_left, 0.0, value)
    tail = torch.log(0.5 * torch.special.erfcx(-left * math.sqrt(0.5))) - 0.5 * left.square()
    return torch.where(is_left, tail, torch.log1p(-0.5 * torch.special.erfc(right * math.sqrt(0.5))))


@own_precision
def log_normal_mass(low: Float[Tensor, "*sizes"], high: Float[Tensor, "*sizes"]) -> Float[Tensor, "*sizes"]:
    """log(Φ(high) − Φ(low)) of a standard normal, low < high; either may be infinite. Differentiable.

    Intervals on the right are mirrored to the left, where log Φ keeps its relative precision down to any depth. Good
    to a few rounding errors of log Φ for intervals that are not narrower than 1e-5 deviations in float32 and 1e-12 in
    float64.
    """
    is_right = low + high > 0
    left, right = torch.where(is_right, -high, low), torch.where(is_right, -low, high)
    below, above = log_ndtr(left), log_ndtr(right)
    gap = (below - above).clamp_max(-torch.finfo(low.dtype).tiny)
    return above + torch.log(-torch.expm1(gap))


@own_precision
def truncated_normal_log_prob(
    value: Float[Tensor, "*#sizes"],
    mean: Float[Tensor, "*#sizes"],
    std: Float[Tensor, "*#sizes"],
    low: Float[Tensor, "*#sizes"],
    high: Float[Tensor, "*#sizes"],
) -> Float[Tensor, "*sizes"]:
    """Log density of a normal cut off at low < high; the same formula, no wall, where the value is outside."""
    scaled = (value - mean) / std
    mass = log_normal_mass(*torch.broadcast_tensors((low - mean) / std, (high - mean) / std))
    return -0.5 * scaled.square() - _HALF_LOG_2PI - std.log() - mass


@own_precision
def truncated_normal_quantile(
    fraction: Float[Tensor, "*#sizes"],
    mean: Float[Tensor, "*#sizes"],
    std: Float[Tensor, "*#sizes"],
    low: Float[Tensor, "*#sizes"],
    high: Float[Tensor, "*#sizes"],
) -> Float[Tensor, "*sizes"]:
    """The value below which the given fraction (0 to 1) of a normal cut off at low <= high lies.

    Fed with uniform numbers it draws samples. Worked in float64 and returned in the dtype of `fraction`, between the
    limits.
    """
    low, high, mean, std = (x.double() for x in (low, high, mean, std))
    start, stop = torch.broadcast_tensors((low - mean) / std, (high - mean) / std)
    part = fraction.double()
    is_right = start + stop > 0  # mirrored to the left, as in `log_normal_mass`
    part = torch.where(is_right, 1 - part, part)
    left, right = torch.where(is_right, -stop, start), torch.where(is_right, -start, stop)
    below, above = (log_ndtr(end).exp() for end in (left, right))  # ndtr has no tail
    inner = torch.special.ndtri(below + part * (above - below))
    # far in the tail both are zero: there the square falls by −2 log of the share, as in an exponential tail
    rest = torch.exp(0.5 * (right.square() - left.square()).clamp_max(0.0))
    tail = -(right.square() - 2 * torch.log((part + (1 - part) * rest).clamp_min(1e-300))).clamp_min(0).sqrt()
    found = torch.where(right < -_TAIL, tail, inner)
    found = torch.where(is_right, -found, found)
    value = mean + std * torch.minimum(torch.maximum(found, start), stop)
    return torch.minimum(torch.maximum(value, low), high).to(fraction.dtype)
