"""A bare forearm for simulated pictures: one truncated elliptic cone that goes on from the wrist."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera, cone, meet_rays, moved, ray_table, slab
from torchhand.hand import HandFrames, ShapeSpace

LENGTH = 0.24
"""Metres."""
THICKENING = 1.45
"""Section at the elbow's end relative to that at the wrist."""

_OVERLAP = 0.006  # metres by which it reaches into the palm, so that no gap opens
_NEAREST = 0.02  # metres before the camera from which on a projected box is trusted
_LENS_MARGIN = 0.05  # what a lens may bend the edges of a box, share of the picture's larger side
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


def cast_forearm(frames: HandFrames, space: ShapeSpace, shape: Float[Tensor, "shape"], camera: Camera) -> ForearmCast:
    """Casts a ray through the centre of every pixel at the forearm of one hand; the wrist is straight."""
    size = (camera.height, camera.width)
    depth = torch.full(size, torch.inf, dtype=shape.dtype, device=shape.device)
    normal = torch.zeros(*size, 3, dtype=shape.dtype, device=shape.device)
    left, top, right, bottom = pixel_box(camera.cam_from_world(forearm_corners(frames, space, shape)), camera)
    if right <= left or bottom <= top:
        return ForearmCast(depth=depth, normal=normal)
    start, length = _section(space, shape), torch.full_like(shape[0], LENGTH)
    rotation, position = _placed(frames)
    rotation, position = camera.rotation @ rotation, camera.cam_from_world(position)
    quadric = moved(cone(start, torch.full_like(length, THICKENING), length), rotation, position)
    clip = moved(slab(torch.zeros_like(length), length), rotation, position)
    rows = torch.arange(top, bottom, dtype=shape.dtype, device=shape.device)
    columns = torch.arange(left, right, dtype=shape.dtype, device=shape.device)
    grid_y, grid_x = torch.meshgrid(rows, columns, indexing="ij")
    origins, directions = camera.rays(torch.stack((grid_x, grid_y), -1).reshape(-1, 2))
    along, clips = (ray_table(matrix[None], origins, directions).squeeze(-1) for matrix in (quadric, clip))
    near = meet_rays(along, clips).near
    is_hit = near.isfinite()
    points = origins + torch.where(is_hit, near, torch.zeros_like(near))[:, None] * directions
    gradient = torch.nn.functional.normalize(points @ quadric[:3, :3] + quadric[:3, 3], dim=-1)
    gradient = torch.where(is_hit[:, None], gradient, torch.zeros_like(gradient))
    depth[top:bottom, left:right] = near.reshape(bottom - top, right - left)
    normal[top:bottom, left:right] = gradient.reshape(bottom - top, right - left, 3)
    return ForearmCast(depth=depth, normal=normal)


def forearm_corners(frames: HandFrames, space: ShapeSpace, shape: Float[Tensor, "shape"]) -> Float[Tensor, "8 3"]:
    """Corners of a box in the world that holds the forearm, metres."""
    rotation, position = _placed(frames)
    half_depth, half_breadth = (THICKENING * _section(space, shape)).tolist()
    corners = [(x, y, z) for x in (-half_depth, half_depth) for y in (0, LENGTH) for z in (-half_breadth, half_breadth)]
    return torch.tensor(corners, dtype=shape.dtype, device=shape.device) @ rotation.T + position


def pixel_box(points_cam: Float[Tensor, "points 3"], camera: Camera) -> tuple[int, int, int, int]:
    """Pixels x0, y0, x1, y1 (exclusive) around points in the camera frame; all of them where one is not in front."""
    if camera.kind == "pinhole" and bool((points_cam[:, 2] < _NEAREST).any()):
        return 0, 0, camera.width, camera.height
    pixels = camera.pixels_from_plane(camera.plane_from_cam(points_cam)).clamp(-1e6, 1e6)
    margin = _LENS_MARGIN * max(camera.width, camera.height) if camera.has_distortion else 0.0
    low, high = (pixels.amin(0) - margin).floor().long().tolist(), (pixels.amax(0) + margin).ceil().long().tolist()
    return max(0, low[0]), max(0, low[1]), min(camera.width, high[0] + 1), min(camera.height, high[1] + 1)


def _section(space: ShapeSpace, shape: Tensor) -> Float[Tensor, "2"]:
    """Semi-axes at the wrist along x and z, metres."""
    half = 0.5 * space.metric(shape)["wrist_breadth"]
    return torch.stack((_DEPTH * half, half))


def _placed(frames: HandFrames) -> tuple[Float[Tensor, "3 3"], Float[Tensor, "3"]]:
    """World from the forearm's own frame, whose y leads to the elbow."""
    hand, wrist = frames.rotation[0], frames.position[0]
    return hand * torch.tensor((1.0, -1.0, -1.0)).to(hand), wrist + _OVERLAP * hand[:, 1]
