"""From the field to an even, closed triangle mesh of a wanted number of vertices."""

from collections.abc import Callable

import gpytoolbox
import numpy as np
import torch
from jaxtyping import Float, Int
from skimage.measure import marching_cubes
from torch import Tensor

Field = Callable[[Tensor], Tensor]

_STEP = 0.0015  # metres, of the grid on which the surface is found
_MARGIN = 0.03
_ROUNDS = 20  # of the remeshing
_CHUNK = 200_000
_DIFFERENCE = 1e-5  # metres
_LONGEST_MOVE = 2e-3  # metres, of one Newton step


def isosurface(
    field: Field, low: Float[Tensor, "3"], high: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "vertices 3"], Int[Tensor, "faces 3"]]:
    """A fine mesh of the field's zero in a box; faces counter-clockwise from outside."""
    axes = [torch.arange(float(a), float(b), _STEP, dtype=torch.float64) for a, b in zip(low, high, strict=True)]
    grid = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)
    values = torch.cat([field(chunk) for chunk in grid.reshape(-1, 3).split(_CHUNK)]).reshape(grid.shape[:3])
    vertices, faces, _, _ = marching_cubes(values.numpy(), 0.0)
    return torch.from_numpy(vertices * _STEP) + grid[0, 0, 0], torch.from_numpy(np.ascontiguousarray(faces)).long()


def even_mesh(
    field: Field, around: Float[Tensor, "points 3"], count: int, *, tolerance: int = 10
) -> tuple[Float[Tensor, "vertices 3"], Int[Tensor, "faces 3"]]:
    """A mesh of the field's zero with `count` vertices, to the tolerance, and triangles of nearly one size.

    Botsch and Kobbelt's remeshing of the isosurface; the edge length is found by bisection. Deterministic.
    """
    fine, fine_faces = isosurface(field, around.amin(0) - _MARGIN, around.amax(0) + _MARGIN)
    low, high = 0.5e-3, 50e-3
    for _ in range(30):
        edge = (low * high) ** 0.5
        points, faces = gpytoolbox.remesh_botsch(fine.numpy(), fine_faces.int().numpy(), _ROUNDS, edge, True)
        if abs(len(points) - count) <= tolerance:
            break
        low, high = (edge, high) if len(points) > count else (low, edge)
    else:
        raise RuntimeError(f"no edge length gives {count} vertices; the last gave {len(points)}")
    vertices, triangles = torch.from_numpy(points), torch.from_numpy(faces).long()
    return balanced(field, vertices, triangles), triangles


def balanced(
    field: Field, vertices: Float[Tensor, "vertices 3"], faces: Int[Tensor, "faces 3"], *, rounds: int = 6
) -> Float[Tensor, "vertices 3"]:
    """The vertices moved along the field's gradient until corners and middles of the triangles lie about it evenly.

    A mesh whose corners lie on a round surface is too thin: its triangles cut the curve.
    """
    for _ in range(rounds):
        middles = field(vertices[faces].mean(1))
        sums = torch.zeros(len(vertices), dtype=vertices.dtype)
        counts = torch.zeros_like(sums)
        for corner in range(3):
            sums.index_add_(0, faces[:, corner], middles)
            counts.index_add_(0, faces[:, corner], torch.ones_like(middles))
        error = 0.5 * (field(vertices) + sums / counts)
        vertices = vertices - error[:, None] * direction(field, vertices)
    return vertices


def direction(field: Field, points: Float[Tensor, "points 3"]) -> Float[Tensor, "points 3"]:
    """Unit gradient of the field, by central differences."""
    steps = _DIFFERENCE * torch.eye(3, dtype=points.dtype)
    gradient = torch.stack([field(points + step) - field(points - step) for step in steps], -1)
    return gradient / gradient.norm(dim=-1, keepdim=True).clamp_min(1e-12)


def projected(
    field: Field, points: Float[Tensor, "points 3"], level: Float[Tensor, "points"], *, rounds: int = 6
) -> Float[Tensor, "points 3"]:
    """The points moved along the gradient to where the field has the given levels."""
    for _ in range(rounds):
        error = (field(points) - level).clamp(-_LONGEST_MOVE, _LONGEST_MOVE)
        points = points - error[:, None] * direction(field, points)
    return points
