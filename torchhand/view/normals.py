"""Normals of the points that a camera sees of a mesh: one per face, or mixed from those of its corners."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.geometry import Camera


def face_normals(points: Float[Tensor, "vertices 3"], faces: Int[Tensor, "faces 3"]) -> Float[Tensor, "faces 3"]:
    """Unit normals, to the side from which the corners go round counter-clockwise; zero of faces without area."""
    a, b, c = points[faces].unbind(1)
    return torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1, eps=1e-30)


def mixed_normals(
    points_cam: Float[Tensor, "vertices 3"],
    normals_cam: Float[Tensor, "vertices 3"],
    faces: Int[Tensor, "faces 3"],
    seen: Int[Tensor, "n"],
    pixels: Float[Tensor, "n 2"],
    depth: Float[Tensor, "n"],
    camera: Camera,
) -> Float[Tensor, "n 3"]:
    """Unit normals between those of the corners of the face that each pixel sees, weighted by its areal coordinates.

    seen: the face that each of `pixels` sees, at `depth` metres; everything in the camera frame.
    """
    a, b, c = points_cam[faces].unbind(1)
    normal = torch.linalg.cross(b - a, c - a)
    normal = normal / (normal * normal).sum(-1, keepdim=True).clamp_min(torch.finfo(normal.dtype).tiny)
    to_second, to_third = torch.linalg.cross(c - a, normal), torch.linalg.cross(normal, b - a)
    first, second, third = normals_cam[faces].unbind(1)
    table = torch.cat((a, to_second, to_third, first, second - first, third - first), -1).index_select(0, seen)
    a, to_second, to_third, first, second, third = table.split(3, -1)
    origin, direction = camera.rays(pixels)
    arm = torch.addcmul(origin, direction, depth[:, None]) - a
    share = (arm * to_second).sum(-1, keepdim=True).clamp(0, 1)
    mixed = torch.addcmul(first, second, share)
    share = torch.minimum((arm * to_third).sum(-1, keepdim=True).clamp_min(0), 1 - share)
    return torch.nn.functional.normalize(torch.addcmul(mixed, third, share), dim=-1)
