"""The picture's contour against the model's outline: what the model leaves unexplained.

Distances of the model from the picture's contour alone are degenerate: a finger folded into the silhouette, or laid
over its neighbour, costs nothing. Here every point of the picture's contour looks for its place on
the posed outline.
"""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.image import Boundary
from torchhand.view import ContourMotion

_HANDS_AT_ONCE = 8  # whose distances stay in the processor's memory


def match_boundary(
    boundary: Boundary,
    points_px: Float[Tensor, "hands points 2"],
    normals: Float[Tensor, "hands points 2"],
    is_usable: Bool[Tensor, "hands points"],
    *,
    turn_px: float,
) -> Int[Tensor, "hands boundary"]:
    """For every point of a picture's boundary the model's nearest; -1 where a hand has no usable point.

    Near in place and in direction: d² = |Δx|² + (turn_px |Δnormal|)², so that the side of a finger goes to the same
    side of a finger.
    """
    scale = points_px.new_tensor((1.0, 1.0, turn_px, turn_px)) / max(turn_px, 1.0)
    model = (torch.cat((points_px, normals), -1) * scale).to(torch.float32).nan_to_num(nan=1e6, posinf=1e6, neginf=-1e6)
    picture = (torch.cat((boundary.points_px, boundary.normals), -1).to(points_px) * scale).to(torch.float32)
    middle = picture.mean(0) if len(picture) else picture.new_zeros(4)
    model, picture = model - middle, picture - middle  # keeps the products small
    length = torch.where(is_usable, model.square().sum(-1), torch.inf)
    # |model - picture|² less what is the same for all of the model, as one product.
    model = torch.cat((-2 * model, length[..., None]), -1)
    picture, groups = torch.nn.functional.pad(picture, (0, 1), value=1.0), model.split(_HANDS_AT_ONCE)
    nearest = [_least((picture @ some.flatten(0, 1).T).unflatten(1, some.shape[:2])) for some in groups]
    return torch.where(is_usable.any(-1, keepdim=True), torch.cat(nearest), -1)


def _least(apart: Float[Tensor, "boundary hands points"]) -> Int[Tensor, "hands boundary"]:
    """Place of the least distance for every hand; on a CPU by numpy, as torch takes ten times as long."""
    if apart.device.type != "cpu":
        return apart.argmin(-1).T
    return torch.from_numpy(apart.detach().numpy().argmin(-1)).T


def coverage_residual(
    motion: ContourMotion,
    boundary: Boundary,
    match: Int[Tensor, "hands boundary"],
    normals: Float[Tensor, "hands points 2"],
    *,
    unmatched_px: float,
) -> tuple[Float[Tensor, "hands boundary"], Float[Tensor, "hands boundary free"]]:
    """How far the model's outline lies beyond (positive) each point of the picture's boundary, px, and the derivative.

    Measured along the normal that the model's point had when it was matched: n · (model - picture). Without a match it
    is `unmatched_px`, and nothing changes it.
    """
    index, has_match = match.clamp_min(0), match >= 0
    pairs = index[..., None].expand(-1, -1, 2)
    normal, place = normals.gather(1, pairs), motion.points_px.gather(1, pairs)
    offset = (normal * (place - boundary.points_px.to(place))).sum(-1)
    moved = motion.along(normals)
    moved = moved.gather(1, index[..., None].expand(-1, -1, moved.shape[-1]))
    if bool(has_match.all()):
        return offset, moved
    return torch.where(has_match, offset, unmatched_px), torch.where(has_match[..., None], moved, 0.0)
