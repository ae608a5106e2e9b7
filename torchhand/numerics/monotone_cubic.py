"""A smooth curve through values that never leaves the span between neighbours (Fritsch and Carlson)."""

import torch
from jaxtyping import Float
from torch import Tensor


def monotone_cubic(
    knots: Float[Tensor, "knots"], values: Float[Tensor, "*batch knots n"], at: Float[Tensor, "places"]
) -> Float[Tensor, "*batch places n"]:
    """Cubic Hermite interpolation, continuous with its slope, at rest at both ends; before and after them it stays.

    Slopes are weighted harmonic means of the neighbouring ones, zero where these differ in sign (as in scipy's
    PchipInterpolator): between two knots every coordinate runs monotonically from the one value to the other, so it
    keeps any limits that the values keep. Two equal values in a row are a rest.

    Raises ValueError for fewer than one knot and for knots that do not increase.
    """
    if len(knots) < 1 or not bool((knots.diff() > 0).all()):
        raise ValueError("knots: expected one or more, increasing")
    if len(knots) == 1:
        return values.expand(*values.shape[:-2], len(at), values.shape[-1]).clone()
    step = knots.diff()[:, None]
    rise = values.diff(dim=-2) / step
    slopes = torch.zeros_like(values)
    before, after = rise[..., :-1, :], rise[..., 1:, :]
    first, second = 2 * step[1:] + step[:-1], step[1:] + 2 * step[:-1]
    turns = before * after <= 0
    mean = (first + second) / (first / torch.where(turns, 1.0, before) + second / torch.where(turns, 1.0, after))
    slopes[..., 1:-1, :] = torch.where(turns, 0.0, mean)
    piece = (torch.searchsorted(knots, at.contiguous(), right=True) - 1).clamp(0, len(knots) - 2)
    width = step[piece]
    fraction = ((at - knots[piece])[:, None] / width).clamp(0, 1)
    start, end = values[..., piece, :], values[..., piece + 1, :]
    at_start, at_end = width * slopes[..., piece, :], width * slopes[..., piece + 1, :]
    eased = fraction * fraction * (3 - 2 * fraction)
    rest = 1 - fraction
    found = start + (end - start) * eased + fraction * rest * (rest * at_start - fraction * at_end)
    # Rounding must not leave the span either.
    return torch.minimum(torch.maximum(found, torch.minimum(start, end)), torch.maximum(start, end))
