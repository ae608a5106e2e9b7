"""How well two silhouettes of a hand agree, compared where both show the hand alone."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def intersection_over_union(
    first: Bool[Tensor, "*#batch height width"],
    second: Bool[Tensor, "*#batch height width"],
    region: Bool[Tensor, "*#batch height width"] | None = None,
    *,
    empty: float = math.nan,
) -> Float[Tensor, "*batch"]:
    """Common area of two masks over their total area, 0 to 1, within a region where one is given; float64.

    `empty` is the value where both masks are empty and there is nothing to compare.
    """
    common, total = first & second, first | second
    if region is not None:
        common, total = common & region, total & region
    common, total = (mask.sum((-2, -1)).double() for mask in (common, total))
    return torch.where(total > 0, common / total.clamp_min(1.0), empty)


def hand_region(
    shape: tuple[int, int],
    wrist_px: Float[Tensor, "2"],
    knuckle_px: Float[Tensor, "2"],
    reach_px: float = math.inf,
) -> Bool[Tensor, "height width"]:
    """Pixels on the fingers' side of the wrist, within `reach_px` of it: where silhouettes of a hand can be compared.

    The line through the wrist, perpendicular to the way to the middle finger's knuckle, cuts off the forearm; the line
    itself belongs to the hand. Points that are unknown (NaN) cut nothing off, nor do points that coincide in the
    picture, as where the hand points at the camera.
    """
    wrist, towards = wrist_px.double(), (knuckle_px - wrist_px).double()
    x = torch.arange(shape[1], device=wrist.device) - wrist[0]
    y = (torch.arange(shape[0], device=wrist.device) - wrist[1])[:, None]
    # Sums over the picture's pixels would be large: columns are compared with rows.
    is_forearm = x * towards[0] < -y * towards[1]
    return ~(is_forearm | (x * x >= reach_px**2 - y * y))
