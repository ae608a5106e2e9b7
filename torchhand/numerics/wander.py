"""Smooth seeded curves of time that start from rest at zero: the material of the motion scripts."""

import torch
from jaxtyping import Float
from torch import Tensor

FREQUENCIES_HZ = (0.12, 0.5)
"""Range from which the sinusoids are drawn; deliberate hand movements are of this pace."""
START_S = 0.4
"""Time in which a curve comes into motion."""

_SINUSOIDS = 3


def wander(
    seconds: Float[Tensor, "frames"], count: int, generator: torch.Generator, *, pace: float = 1.0
) -> Float[Tensor, "frames {count}"]:
    """`count` independent sums of sinusoids within [-1, 1], zero with zero speed at time 0.

    pace multiplies all frequencies. The curves depend on the time alone: a longer sequence of the same seed begins with
    the shorter one.
    """
    low, high = FREQUENCIES_HZ
    shape = (_SINUSOIDS, count)
    frequency = pace * (low + (high - low) * torch.rand(shape, generator=generator, dtype=seconds.dtype))
    phase = 2 * torch.pi * torch.rand(shape, generator=generator, dtype=seconds.dtype)
    weight = 0.3 + torch.rand(shape, generator=generator, dtype=seconds.dtype)
    waves = (2 * torch.pi * frequency * seconds[:, None, None] + phase).sin() - phase.sin()
    fraction = weight / ((1 + phase.sin().abs()) * weight).sum(
        0
    )  # the bound |sum| <= 1 is reached where the phases agree
    start = 1 - torch.exp(-((pace * seconds / START_S) ** 2))
    return (waves * fraction).sum(1) * start[:, None]


def ease(fraction: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Curve from 0 to 1 with no speed and no acceleration at either end; constant outside [0, 1]."""
    x = fraction.clamp(0, 1)
    return x * x * x * (10 + x * (6 * x - 15))


def bump(fraction: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """0 to 1 and back to 0 over [0, 1], at rest at both ends and in the middle; zero outside."""
    return ease(2 * fraction) - ease(2 * fraction - 1)
