"""The contour of closed meshes in a picture: edges between a face that is turned to the camera and one that is not."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

NEAREST = 1e-3
"""Metres before the camera: faces with a corner that is nearer, or behind, are left out."""


@dataclass(frozen=True, kw_only=True)
class MeshEdges:
    """Edges of a closed mesh, each once."""

    ends: Int[Tensor, "edges 2"]
    """Vertices of each edge, in the order in which the first of its faces goes round."""
    faces: Int[Tensor, "edges 2"]
    """The two faces of each edge."""


@dataclass(frozen=True, kw_only=True)
class ContourEdges:
    """Directed edges of all pictures' contours: the surface lies to the side of +x where an edge goes down (+y)."""

    ends: Int[Tensor, "contour 2"]
    """Places of the ends in the flat list of all pictures' vertices."""
    picture: Int[Tensor, "contour"]


def mesh_edges(faces: Int[Tensor, "faces 3"]) -> MeshEdges:
    """The edges. Raises ValueError for a mesh with holes, or whose faces do not all go round the same way."""
    halves = torch.stack((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]), 1).reshape(-1, 2).long()
    owner = torch.arange(len(faces), device=faces.device).repeat_interleave(3)
    key, order = (halves.amin(1) * (halves.max() + 1) + halves.amax(1)).sort(stable=True)
    halves, owner = halves[order], owner[order]
    is_paired = len(key) % 2 == 0 and bool((key[::2] == key[1::2]).all() and (key[2::2] != key[1:-1:2]).all())
    if not is_paired or not bool((halves[::2] == halves[1::2].flip(1)).all()):
        raise ValueError("faces: expected a closed mesh whose faces all go round the same way, two at every edge")
    return MeshEdges(ends=halves[::2].contiguous(), faces=owner.reshape(-1, 2))


def faces_seen(
    points_px: Float[Tensor, "pictures vertices 2"],
    depth: Float[Tensor, "pictures vertices"],
    faces: Int[Tensor, "faces 3"],
    is_mirrored: Bool[Tensor, "#pictures"],
) -> Bool[Tensor, "pictures faces"]:
    """Faces before the camera that are turned to it: their corners go round counter-clockwise as it sees them.

    is_mirrored: the picture is a mirror image (the camera's focal lengths have different signs).
    """
    corners = faces.reshape(-1)
    x, y = (points_px[..., axis].index_select(1, corners).unflatten(1, (-1, 3)) for axis in range(2))
    (ax, bx, cx), (ay, by, cy) = x.unbind(-1), y.unbind(-1)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    is_ahead = ((depth >= NEAREST) & points_px.isfinite().all(-1)).index_select(1, corners)
    return torch.where(is_mirrored[:, None], area > 0, area < 0) & is_ahead.unflatten(1, (-1, 3)).all(-1)


def contour_edges(
    is_seen: Bool[Tensor, "pictures faces"], edges: MeshEdges, vertices: int, is_mirrored: Bool[Tensor, "#pictures"]
) -> ContourEdges:
    """Boundary of the faces that are seen: in every picture closed polygons, whatever the faces are."""
    one, other = (is_seen.index_select(1, side) for side in edges.faces.unbind(1))
    picture, edge = (one != other).nonzero(as_tuple=True)
    ends = edges.ends.index_select(0, edge)
    is_forward = one[picture, edge] != is_mirrored.expand(len(one)).index_select(0, picture)
    ends = torch.where(is_forward[:, None], ends, ends.flip(1))
    return ContourEdges(ends=ends + vertices * picture[:, None], picture=picture)
