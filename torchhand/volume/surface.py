"""The surface of a hull as a mesh: the faces of its finest octants that have no neighbour."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.volume.octree import Octree


def hull_quads(
    octree: Octree, *, frame: int = 0, unknown: bool = False
) -> tuple[Float[Tensor, "vertices 3"], Int[Tensor, "quads 4"], Int[Tensor, "quads 3"]]:
    """Vertices (world frame, metres, float64), corners and outward normals of the square faces of one frame's hull.

    Corners are counter-clockwise seen from outside, and shared; the surface is closed, and empty without hull.
    """
    filled, first = octree.occupancy(frame=frame, unknown=unknown)
    device, corners, normals = filled.device, [], []
    padded = torch.nn.functional.pad(filled, (1,) * 6) if filled.numel() else filled
    for axis in range(3):
        for sign in (1, -1):
            is_bare = padded & ~padded.roll(-sign, axis)
            cells = is_bare.nonzero() - 1
            normal = torch.zeros(3, dtype=torch.long, device=device)
            normal[axis] = sign
            one, other = torch.eye(3, dtype=torch.long, device=device)[[(axis + 1) % 3, (axis + 2) % 3]]
            one, other = (one, other) if sign > 0 else (other, one)
            base = cells + normal.clamp_min(0)
            corners.append(torch.stack((base, base + one, base + one + other, base + other), 1))
            normals.append(normal.expand(len(cells), 3))
    points = torch.cat(corners)
    places, index = torch.unique(points.reshape(-1, 3), dim=0, return_inverse=True)
    grid = places.double() + torch.tensor(first, dtype=torch.float64, device=device)
    vertices = grid * octree.leaf_side + torch.tensor(octree.root.corner, dtype=torch.float64, device=device)
    return vertices, index.reshape(-1, 4), torch.cat(normals)


def hull_mesh(
    octree: Octree, *, frame: int = 0, unknown: bool = False
) -> tuple[Float[Tensor, "vertices 3"], Int[Tensor, "faces 3"]]:
    """The surface of one frame's hull in triangles, counter-clockwise seen from outside; metres, world frame."""
    vertices, quads, _ = hull_quads(octree, frame=frame, unknown=unknown)
    return vertices, torch.cat((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]))
