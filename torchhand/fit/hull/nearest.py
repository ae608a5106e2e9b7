"""Nearest points of the skin, by place and direction, of many hands at once."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import is_host


def match_hull(
    hull_points: Float[Tensor, "hull 3"],
    hull_normals: Float[Tensor, "hull 3"],
    points: Float[Tensor, "hands points 3"],
    normals: Float[Tensor, "hands points 3"],
    *,
    turn: float,
) -> Int[Tensor, "hands hull"]:
    """Nearest point of each hand's skin for every point of the hull's surface.

    Near in place and in direction: d² = |Δx|² + (turn |Δnormal|)², so that the back of a finger goes to the back of a
    finger. turn: metres that a turn of the surface by one radian is worth. Points that are not finite are nobody's
    nearest, unless all of a hand's are.
    """
    middle = hull_points.mean(0) if len(hull_points) else hull_points.new_zeros(3)
    skin = torch.cat((points - middle, turn * normals), -1)
    wanted = torch.cat((hull_points - middle, turn * hull_normals), -1)
    return nearest_columns(wanted.to(skin)[None], skin.to(torch.float32).mT[:, None]).squeeze(1)


def nearest_columns(
    wanted: Float[Tensor, "views wanted n"], points: Float[Tensor, "hands views n points"]
) -> Int[Tensor, "hands views wanted"]:
    """Nearest column of each hand for each wanted place, view by view, in single precision.

    Columns that are not finite are nobody's nearest, unless all of a hand's are.
    """
    points = points.to(torch.float32).nan_to_num(nan=1e3, posinf=1e3, neginf=-1e3)
    points = torch.cat((points, points.square().sum(-2, keepdim=True)), -2)
    wanted = wanted.to(points)
    wanted = torch.cat((-2 * wanted, torch.ones_like(wanted[..., :1])), -1)
    return torch.stack([_nearest(own, seen) for own, seen in zip(wanted, points.unbind(1), strict=True)], 1)


def _nearest(wanted: Float[Tensor, "wanted n"], points: Float[Tensor, "hands n points"]) -> Int[Tensor, "hands wanted"]:
    """Where wanted · column is least."""
    if not is_host(points.device):
        return (wanted @ points).argmin(-1)
    # Hand by hand, so that the distances stay in the processor's cache; numpy is ten times faster than torch's own.
    wanted = wanted.detach()
    return torch.from_numpy(np.stack([(wanted @ seen).numpy().argmin(-1) for seen in points.detach().unbind()]))
