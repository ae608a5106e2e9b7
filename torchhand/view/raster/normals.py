"""Normals of the points that a camera sees of a mesh: one per face, or mixed from those of its corners."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.view.raster.triangles import SeenTriangles, slopes


def face_normals(points: Float[Tensor, "vertices 3"], faces: Int[Tensor, "faces 3"]) -> Float[Tensor, "faces 3"]:
    """Unit normals, to the side from which the corners go round counter-clockwise; zero of faces without area."""
    a, b, c = points[faces].unbind(1)
    return torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1, eps=1e-30)


def mixed_normals(
    seen: SeenTriangles, triangle: Int[Tensor, "n"], points: Float[Tensor, "n 2"], camera: Camera
) -> Float[Tensor, "n 3"]:
    """Unit normals in the camera frame at points of the picture (of the plane, as `seen.corners`), between those of
    the corners.

    Over the picture of a triangle the normal over the depth is affine (orthographic: the normal), and its length means
    nothing.
    """
    assert seen.normals is not None
    scaled = seen.normals if camera.kind == "orthographic" else seen.normals * seen.nearness[..., None]
    table = torch.cat((seen.corners[:, 0], scaled[:, 0], slopes(seen.corners, scaled).flatten(1)), -1)
    corner, base, along_x, along_y = table.index_select(0, triangle).split((2, 3, 3, 3), -1)
    x, y = (points - corner).split(1, -1)
    return torch.nn.functional.normalize(base + along_x * x + along_y * y, dim=-1, eps=1e-30)
