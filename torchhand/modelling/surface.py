"""From the field to an even, closed triangle mesh of a wanted number of vertices."""

from collections.abc import Callable

import gpytoolbox
import numpy as np
import torch
from jaxtyping import Float, Int
from skimage.measure import marching_cubes
from torch import Tensor

Field = Callable[[Tensor], Tensor]

_MARGIN = 0.03
_ROUNDS = 20  # of the remeshing
_CHUNK = 200_000
_EVENING = 3  # rounds
_LONGEST_MOVE = 2e-3  # metres, of one Newton step


def isosurface(
    field: Field, low: Float[Tensor, "3"], high: Float[Tensor, "3"], *, step: float
) -> tuple[Float[Tensor, "vertices 3"], Int[Tensor, "faces 3"]]:
    """A fine mesh of the field's zero in a box, found on a grid of that step; faces counter-clockwise from outside."""
    axes = [torch.arange(float(a), float(b), step, dtype=torch.float64) for a, b in zip(low, high, strict=True)]
    grid = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)
    values = torch.cat([field(chunk) for chunk in grid.reshape(-1, 3).split(_CHUNK)]).reshape(grid.shape[:3])
    vertices, faces, _, _ = marching_cubes(values.numpy(), 0.0)
    return torch.from_numpy(vertices * step) + grid[0, 0, 0], torch.from_numpy(np.ascontiguousarray(faces)).long()


def even_mesh(
    field: Field, around: Float[Tensor, "points 3"], count: int, *, tolerance: int = 10, step: float = 0.0015
) -> tuple[Float[Tensor, "vertices 3"], Int[Tensor, "faces 3"]]:
    """A mesh of the field's zero with `count` vertices, to the tolerance, and triangles of nearly one size.

    Botsch and Kobbelt's remeshing of the isosurface; the edge length is found by bisection. Deterministic.
    """
    fine, fine_faces = isosurface(field, around.amin(0) - _MARGIN, around.amax(0) + _MARGIN, step=step)
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
    field: Field, vertices: Float[Tensor, "vertices 3"], faces: Int[Tensor, "faces 3"], *, rounds: int = 4
) -> Float[Tensor, "vertices 3"]:
    """The vertices moved along the field's gradient until corners and middles of the triangles lie about it evenly.

    A mesh whose corners lie on a round surface is too thin: its triangles cut the curve. So the corners are raised by
    half of what the triangles' middles lack, evened out over the neighbourhood: outlines are then right on average.
    """
    level = torch.zeros(len(vertices), dtype=vertices.dtype)
    for _ in range(rounds):
        vertices = projected(field, vertices, level)
        residual = _spread(-field(vertices[faces].mean(1)) - level[faces].mean(1), faces, len(vertices))
        for _ in range(_EVENING):
            residual = _spread(residual[faces].mean(1), faces, len(vertices))
        level = level + 0.5 * residual
    return projected(field, vertices, level)


def _spread(values: Float[Tensor, "faces"], faces: Int[Tensor, "faces 3"], count: int) -> Float[Tensor, "vertices"]:
    """Mean over the faces of each vertex."""
    sums, faces_met = torch.zeros(2, count, dtype=values.dtype)
    for corner in faces.unbind(1):
        sums.index_add_(0, corner, values)
        faces_met.index_add_(0, corner, torch.ones_like(values))
    return sums / faces_met


def projected(
    field: Field, points: Float[Tensor, "points 3"], level: Float[Tensor, "points"], *, rounds: int = 6
) -> Float[Tensor, "points 3"]:
    """The points moved along the gradient to where the field has the given levels."""
    for _ in range(rounds):
        points = points.detach().requires_grad_()
        value = field(points)
        (gradient,) = torch.autograd.grad(value.sum(), points)
        error = (value.detach() - level).clamp(-_LONGEST_MOVE, _LONGEST_MOVE)
        points = points - error[:, None] * torch.nn.functional.normalize(gradient, dim=-1)
    return points.detach()
