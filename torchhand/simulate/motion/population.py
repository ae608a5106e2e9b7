"""Simulated people: hand shapes drawn from the spread of the shape parameters."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import ShapeSpace


def sample_shape(
    space: ShapeSpace, generator: torch.Generator, *batch: int, spread: float = 1.0
) -> Float[Tensor, "*batch shape"]:
    """Shape vectors of random people: independent Gaussians truncated to the bounds.

    The mean is the default shape, `spread` multiplies the standard deviations. Drawn by inverting the distribution
    function inside the bounds, so no value piles up at them. Device and dtype are the space's; the generator is one of
    the CPU.
    """
    if spread < 0:
        raise ValueError(f"spread: expected 0 or more, got {spread}")
    uniform = torch.rand((*batch, len(space.names)), generator=generator, dtype=torch.float64)
    mean, std = space.default.double().cpu(), spread * space.std.double().cpu()
    lower, upper = space.lower.double().cpu(), space.upper.double().cpu()
    safe = std.clamp_min(1e-12)
    low, high = torch.special.ndtr((lower - mean) / safe), torch.special.ndtr((upper - mean) / safe)
    drawn = mean + std * torch.special.ndtri(low + uniform * (high - low)).clamp(-40, 40)
    return drawn.clamp(lower, upper).to(space.default)
