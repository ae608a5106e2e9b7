"""Losses between keypoints of the hand and those of a detector, in pictures or in space."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.losses.reduction import Reduction, reduced
from torchhand.precision import own_precision


@own_precision
def keypoint_loss(
    points: Float[Tensor, "*batch keypoints dimensions"],
    target: Float[Tensor, "*#batch keypoints dimensions"],
    weight: Float[Tensor, "*#batch keypoints"] | None = None,
    *,
    std: float,
    reduction: Reduction = "mean",
) -> Float[Tensor, "*out"]:
    """Mean over the keypoints of √(1 + e²) − 1, e being a point's distance from its target over `std`.

    ½ e² for points that are nearly right, and e for those far off, so that a point that a detector has put elsewhere
    pulls no harder than others. points, target: px in the picture, or metres in one frame; a target that is not finite
    is missing. weight: of each point, such as a detector's confidence; 0 or more. std: standard deviation of the
    detector's error along each axis, in the unit of the points; above 0.
    """
    if not std > 0:
        raise ValueError(f"std: expected above 0, got {std}")
    is_there = target.isfinite().all(-1)
    offset = torch.where(is_there[..., None], points - torch.where(is_there[..., None], target, 0.0), 0.0)
    squared = (offset / std).square().sum(-1)
    cost = squared / ((1 + squared).sqrt() + 1)  # √(1 + e²) − 1 without cancellation
    share = is_there.to(cost) if weight is None else is_there * weight
    share = share.expand_as(cost)
    losses = (share * cost).sum(-1) / share.sum(-1).clamp_min(torch.finfo(cost.dtype).tiny)
    return reduced(losses, reduction)
