"""Distances from points to the shapes that the hand's surface is blended from; negative inside, metres."""

import torch
from jaxtyping import Float
from torch import Tensor


def round_cone(
    points: Float[Tensor, "*points 3"],
    start: Float[Tensor, "3"],
    end: Float[Tensor, "3"],
    start_radius: Float[Tensor, ""],
    end_radius: Float[Tensor, ""],
) -> Float[Tensor, "*points"]:
    """The hull of two balls; exact. The balls must not contain each other."""
    axis = end - start
    length = axis.norm()
    axis = axis / length
    sine = (start_radius - end_radius) / length  # of the cone's half angle
    cosine = (1 - sine * sine).sqrt()
    from_start = points - start
    along = from_start @ axis
    across = (from_start - along[..., None] * axis).norm(dim=-1)
    foot = along - across * sine / cosine  # where the surface's normal through the point meets the axis
    to_start = from_start.norm(dim=-1) - start_radius
    to_end = (points - end).norm(dim=-1) - end_radius
    side = across * cosine + along * sine - start_radius
    return torch.where(foot <= 0, to_start, torch.where(foot >= length, to_end, side))


def ellipsoid(
    points: Float[Tensor, "*points 3"],
    centre: Float[Tensor, "3"],
    rotation: Float[Tensor, "3 3"],
    axes: Float[Tensor, "3"],
) -> Float[Tensor, "*points"]:
    """An ellipsoid with semi-axes along the columns of `rotation`; first-order distance, exact on the surface."""
    local = (points - centre) @ rotation
    value = (local / axes).norm(dim=-1)
    slope = (local / axes.square()).norm(dim=-1).clamp_min(1e-9)
    return value * (value - 1) / slope


def blended(first: Tensor, second: Tensor, width: float | Tensor) -> Tensor:
    """Smooth union: the smaller distance, with a fillet where the two are nearer to each other than `width`."""
    overlap = (width - (first - second).abs()).clamp_min(0) / width
    return torch.minimum(first, second) - 0.25 * width * overlap * overlap
