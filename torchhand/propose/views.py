"""Square views of a part of a picture: what a camera would see that is turned towards it, and holds it upright."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.hand import PALM

_AHEAD = 1e-3

SIDE_PX = 48
"""Width and height of what the network sees."""


@dataclass(frozen=True, kw_only=True)
class SquareViews:
    """Cameras in the place of another one, turned towards something and with a square picture of their own.

    Turning a camera about its centre is exact for whatever is before it: no perspective is lost.
    """

    cam_from_view: Float[Tensor, "*batch 3 3"]
    reach: Float[Tensor, "*batch"]
    """Half the side of the square on the normalised image plane of the view."""

    def __getitem__(self, index: "int | slice | Int[Tensor, '...']") -> "SquareViews":
        return SquareViews(cam_from_view=self.cam_from_view[index], reach=self.reach[index])

    def plane(self, side_px: int) -> Float[Tensor, "*batch side side 2"]:
        """Points of the normalised image plane of the camera at the pixels of the square, row by row; infinitely far
        where a ray points backwards."""
        like = self.reach
        steps = (2 * torch.arange(side_px, dtype=like.dtype, device=like.device) + 1) / side_px - 1
        x, y, axis = self.cam_from_view[..., None, None].unbind(-3)
        across = (x * self.reach[..., None, None, None]) * steps + axis
        rays = across + (y * self.reach[..., None, None, None]) * steps[:, None]
        ahead = rays[..., 2:, :, :]
        plane = torch.where(ahead > _AHEAD, rays[..., :2, :, :] / ahead, torch.inf)
        return plane.movedim(-3, -1)


def views_towards(
    centre: Float[Tensor, "*batch 3"], up: Float[Tensor, "*batch 3"], reach: Float[Tensor, "*batch"]
) -> SquareViews:
    """Views whose axis goes through a point of the camera frame and in which a direction of that frame points upwards.

    A direction along the axis has no picture: the view is then turned in any way.
    """
    forward = torch.nn.functional.normalize(centre, dim=-1)
    across = torch.linalg.cross(forward, up)
    fallback = torch.linalg.cross(forward, forward.roll(1, -1) * forward.new_tensor((1.0, -1.0, 1.0)))
    across = torch.where(across.norm(dim=-1, keepdim=True) > 1e-6 * up.norm(dim=-1, keepdim=True), across, fallback)
    right = torch.nn.functional.normalize(across, dim=-1)
    down = torch.linalg.cross(forward, right)
    return SquareViews(cam_from_view=torch.stack((right, down, forward), -1), reach=reach)


def palm_middle(keypoints: Float[Tensor, "*batch 21 3"]) -> Float[Tensor, "*batch 3"]:
    """Mean of wrist and knuckles."""
    return keypoints[..., list(PALM), :].mean(-2)
