"""Which point of the model's outline every point of a picture's contour belongs to.

Distances of the model from the picture's contour alone are degenerate: a finger folded into the silhouette, or laid
over its neighbour, costs nothing. Here every point of the picture's contour looks for its place on the posed outline.
"""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import at_once_on, is_host
from torchhand.image import Boundary

_HANDS_AT_ONCE = 8  # whose distances stay in the processor's memory


def match_boundary(
    boundary: Boundary,
    points_px: Float[Tensor, "hands points 2"],
    normals: Float[Tensor, "hands points 2"],
    is_usable: Bool[Tensor, "hands points"],
    *,
    turn_px: float | Float[Tensor, "hands"],
) -> Int[Tensor, "hands boundary"]:
    """Nearest point of the model for every point of a picture's boundary; -1 where a hand has no usable point.

    Near in place and in direction: d² = |Δx|² + (turn_px |Δnormal|)², so that the side of a finger goes to the same
    side of a finger.
    """
    turn = torch.as_tensor(turn_px, dtype=torch.float32, device=points_px.device).expand(len(points_px))
    if not is_host(points_px.device):
        return _nearest(boundary, points_px, normals, is_usable, turn)
    # Two thirds of a model's points lie inside its outline. On the processor, where sizes are known at once, they go.
    most = int(is_usable.sum(-1).max()) if is_usable.any() else 1
    usable = is_usable.to(torch.uint8).argsort(dim=-1, descending=True, stable=True)[:, :most]
    places = usable[..., None].expand(-1, -1, 2)
    nearest = _nearest(
        boundary, points_px.gather(1, places), normals.gather(1, places), is_usable.gather(1, usable), turn
    )
    return torch.where(nearest < 0, nearest, usable.gather(1, nearest.clamp_min(0)))


def _nearest(
    boundary: Boundary,
    points_px: Float[Tensor, "hands points 2"],
    normals: Float[Tensor, "hands points 2"],
    is_usable: Bool[Tensor, "hands points"],
    turn_px: Float[Tensor, "hands"],
) -> Int[Tensor, "hands boundary"]:
    """`match_boundary` among all the points that are given."""
    picture = torch.cat((boundary.points_px, boundary.normals), -1).to(points_px).to(torch.float32)
    middle = picture.mean(0) if len(picture) else picture.new_zeros(4)
    model = torch.cat((points_px, normals), -1).to(torch.float32)
    model = model.nan_to_num(nan=1e6, posinf=1e6, neginf=-1e6) - middle  # keeps the products small, as do the weights
    ratio = turn_px.clamp_min(1.0)
    near, alike = (1 / ratio).square(), (turn_px / ratio).square()
    weighted = model * torch.stack((near, near, alike, alike), -1)[:, None]
    length = torch.where(is_usable, (weighted * model).sum(-1), torch.inf)
    # The weighted |model - picture|² less what is the same for all of the model, as one product.
    rows = torch.cat((-2 * weighted, length[..., None]), -1).split(at_once_on(model.device, _HANDS_AT_ONCE))
    picture = torch.nn.functional.pad(picture - middle, (0, 1), value=1.0)
    nearest = [_argmin((picture @ some.flatten(0, 1).T).unflatten(1, some.shape[:2])) for some in rows]
    return torch.where(is_usable.any(-1, keepdim=True), torch.cat(nearest), -1)


def _argmin(distance: Float[Tensor, "boundary hands points"]) -> Int[Tensor, "hands boundary"]:
    """Place of the least distance for every hand; on a CPU by numpy, as torch takes ten times as long."""
    if not is_host(distance.device):
        return distance.argmin(-1).T
    return torch.from_numpy(distance.detach().numpy().argmin(-1)).T
