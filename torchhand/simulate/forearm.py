"""A bare forearm for simulated pictures: one truncated elliptic cone that goes on from the wrist."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera, cone, meet_rays, moved, ray_coefficients, slab
from torchhand.hand import HandFrames, ShapeSpace

LENGTH = 0.24
"""Metres."""
THICKENING = 1.45
"""Section at the elbow's end relative to that at the wrist."""

_OVERLAP = 0.006  # metres by which it reaches into the palm, so that no gap opens
_DEPTH = 0.72  # thickness relative to breadth


@dataclass(frozen=True, kw_only=True)
class ForearmCast:
    """What a camera sees of a forearm."""

    depth: Float[Tensor, "height width"]
    """z in the camera frame, metres; infinite where it is not."""
    normal: Float[Tensor, "height width 3"]
    """Outward, unit, in the camera frame; zero where it is not."""

    @property
    def mask(self) -> Bool[Tensor, "height width"]:
        return self.depth.isfinite()


def cast_forearm(
    frames: HandFrames, space: ShapeSpace, shape: Float[Tensor, "shape"], camera: Camera
) -> ForearmCast:
    """Casts a ray through the centre of every pixel at the forearm of one hand; the wrist is straight."""
    half = 0.5 * space.metric(shape)["wrist_breadth"]
    length = torch.full_like(half, LENGTH)
    start = torch.stack((_DEPTH * half, half))
    flip = torch.diag(torch.tensor((1.0, -1.0, -1.0), dtype=shape.dtype, device=shape.device))
    rotation = camera.rotation @ frames.rotation[0] @ flip
    overlap = torch.tensor((0.0, _OVERLAP, 0.0), dtype=shape.dtype, device=shape.device)
    position = camera.cam_from_world(frames.position[0] + frames.rotation[0] @ overlap)
    quadric = moved(cone(start, torch.full_like(half, THICKENING), length), rotation, position)
    clip = moved(slab(torch.zeros_like(half), length), rotation, position)
    rows = torch.arange(camera.height, dtype=shape.dtype, device=shape.device)
    columns = torch.arange(camera.width, dtype=shape.dtype, device=shape.device)
    grid_y, grid_x = torch.meshgrid(rows, columns, indexing="ij")
    origins, directions = camera.rays(torch.stack((grid_x, grid_y), -1).reshape(-1, 2))
    along, clips = (ray_coefficients(matrix, origins, directions) for matrix in (quadric, clip))
    depth = meet_rays(along, clips).near
    is_hit = depth.isfinite()
    point = origins + torch.where(is_hit, depth, torch.zeros_like(depth))[:, None] * directions
    gradient = torch.nn.functional.normalize(point @ quadric[:3, :3] + quadric[:3, 3], dim=-1)
    normal = torch.where(is_hit[:, None], gradient, torch.zeros_like(gradient))
    size = (camera.height, camera.width)
    return ForearmCast(depth=depth.reshape(size), normal=normal.reshape(*size, 3))
