"""The hull's surface against the skin: what of the hull the hand leaves unexplained.

A visual hull is larger than the hand where no camera looks in between two fingers or behind the palm. Its surface is
the hand's wherever it touches it, so points far from all skin must count for little: the loss must let them go.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit.hull.inside import PointMotion


def match_hull(
    hull_points: Float[Tensor, "hull 3"],
    hull_normals: Float[Tensor, "hull 3"],
    points: Float[Tensor, "hands points 3"],
    normals: Float[Tensor, "hands points 3"],
    *,
    turn: float,
) -> Int[Tensor, "hands hull"]:
    """For every point of the hull's surface the nearest point of each hand's skin.

    Near in place and in direction: d² = |Δx|² + (turn |Δnormal|)², so that the back of a finger goes to the back of a
    finger. turn: metres that a turn of the surface by one radian is worth. Points that are not finite are nobody's
    nearest, unless all of a hand's are.
    """
    middle = hull_points.mean(0) if len(hull_points) else hull_points.new_zeros(3)
    skin = torch.cat((points - middle, turn * normals), -1)
    return nearest_points(torch.cat((hull_points - middle, turn * hull_normals), -1).to(skin), skin)


def nearest_points(
    wanted: Float[Tensor, "wanted n"], points: Float[Tensor, "hands points n"]
) -> Int[Tensor, "hands wanted"]:
    """For each wanted place the nearest point of each hand, in single precision.

    Points that are not finite are nobody's nearest, unless all of a hand's are.
    """
    return nearest_columns(wanted.to(points)[None], points.to(torch.float32).mT[:, None]).squeeze(1)


def nearest_columns(
    wanted: Float[Tensor, "views wanted n"], points: Float[Tensor, "hands views n points"]
) -> Int[Tensor, "hands views wanted"]:
    """For each wanted place the nearest column of each hand, view by view, in single precision.

    Columns that are not finite are nobody's nearest, unless all of a hand's are.
    """
    points = points.to(torch.float32).nan_to_num(nan=1e3, posinf=1e3, neginf=-1e3)
    points = torch.cat((points, points.square().sum(-2, keepdim=True)), -2)
    wanted = wanted.to(points)
    wanted = torch.cat((-2 * wanted, torch.ones_like(wanted[..., :1])), -1)
    # View by view, so that the distances stay in the processor's cache.
    return torch.stack([_least(own @ seen) for own, seen in zip(wanted, points.unbind(1), strict=True)], 1)


def _least(values: Float[Tensor, "hands wanted points"]) -> Int[Tensor, "hands wanted"]:
    if values.device.type == "cpu":  # ten times faster than torch's own
        return torch.from_numpy(values.detach().numpy().argmin(-1))
    return values.argmin(-1)


def hull_covered_residual(
    motion: PointMotion,
    hull_points: Float[Tensor, "hull 3"],
    normals: Float[Tensor, "hands hull 3"],
) -> tuple[Float[Tensor, "hands hull"], Float[Tensor, "hands hull free"]]:
    """How far the skin lies beyond (positive) each point of the hull's surface, metres, and the derivative.

    motion: of the skin's point that belongs to each point of the hull. Measured along the normal that the skin had
    there when the two were matched, n · (skin - hull): the skin is free to slide.
    """
    apart = motion.points - hull_points.to(motion.points)
    return (normals * apart).sum(-1), motion.along(normals)
