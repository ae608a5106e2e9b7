"""Mean depth of what pixels show of meshes, and how it jumps at the edges that hide another part."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.view.raster import SeenTriangles, nearest_faces
from torchhand.view.soft.placed import PlacedMeshes

SAMPLES = 2
"""Samples along each side of a pixel."""
_BESIDE_PX = 0.5  # how far beyond an edge one looks for what it hides


@dataclass(frozen=True, kw_only=True)
class DepthSamples:
    """Depth at the places of a grid finer than the pixels that see a mesh."""

    place: Int[Tensor, "samples"]
    """In the flat list of all pictures' samples, row by row."""
    depth: Float[Tensor, "samples"]
    """Metres; differentiable."""


def depth_samples(placed: PlacedMeshes, faces: Int[Tensor, "faces 3"]) -> DepthSamples:
    """Depth of the nearest faces."""
    count, height, width = placed.boundary.coverage.shape
    size = (count, height * SAMPLES, width * SAMPLES)
    with torch.no_grad():
        picture, face = placed.is_seen.nonzero(as_tuple=True)
        vertex = faces.index_select(0, face) + picture[:, None] * placed.points_px.shape[1]
        fine = (placed.flat_px + 0.5) * SAMPLES - 0.5
        triangles = SeenTriangles(
            corners=fine[vertex], nearness=placed.nearness.reshape(-1)[vertex], face=face, mesh=picture
        )
        winner = nearest_faces(triangles, size).reshape(-1)
        place = (winner >= 0).nonzero()[:, 0]
        vertex = vertex.index_select(0, winner.index_select(0, place)).reshape(-1)
        column, row = place % size[2], place // size[2] % size[1]
        x, y = ((cell + 0.5) / SAMPLES - 0.5 for cell in (column.to(fine), row.to(fine)))
    ax, bx, cx, ay, by, cy = placed.flat_px.index_select(0, vertex).unflatten(0, (-1, 3)).permute(2, 1, 0).flatten(0, 1)
    a, b, c = placed.nearness.reshape(-1).index_select(0, vertex).unflatten(0, (-1, 3)).unbind(1)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    of_b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
    of_c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
    nearness = a + of_b * (b - a) + of_c * (c - a)
    low, high = torch.minimum(torch.minimum(a, b), c).detach(), torch.maximum(torch.maximum(a, b), c).detach()
    return DepthSamples(place=place, depth=placed.depth_of(torch.minimum(torch.maximum(nearness, low), high)))


def depth_within(placed: PlacedMeshes, samples: DepthSamples) -> Float[Tensor, "pictures height width"]:
    """Mean of each pixel's samples; in pixels that are covered but hold none, of the edges within; 0 beside."""
    found = placed.boundary
    count, height, width = found.coverage.shape
    column = samples.place % (width * SAMPLES) // SAMPLES
    row = samples.place // (width * SAMPLES) // SAMPLES
    pixel = row * width + column
    total = torch.zeros_like(found.coverage).reshape(-1)
    hits = total.index_add(0, pixel, torch.ones_like(samples.depth))
    total = total.index_add(0, pixel, samples.depth)
    pieces = (found.is_outer & (hits.index_select(0, found.pixel) == 0)).nonzero()[:, 0]
    at = found.pixel.index_select(0, pieces)
    of_edges = torch.zeros_like(total).index_add(0, at, _edge_depth(placed)[pieces])
    edges = torch.zeros_like(total).index_add(0, at, torch.ones_like(pieces).to(total))
    depth = (total + of_edges) / (hits + edges).clamp_min(1)
    return torch.where(found.coverage.reshape(-1) > 0, depth, 0.0).reshape(count, height, width)


def jumps(
    placed: PlacedMeshes, samples: DepthSamples, depth: Float[Tensor, "pictures height width"]
) -> Float[Tensor, "pieces"]:
    """What a piece of an edge adds to the depth where it moves outward, metres.

    Its own depth less that of what it hides; at an outer edge less the pixel's mean, which it draws towards its own.
    Edges that are hidden themselves add nothing.
    """
    found = placed.boundary
    count, height, width = depth.shape
    with torch.no_grad():
        pieces, own = found.pieces, _edge_depth(placed)
        first, last = (placed.flat_px.index_select(0, end) for end in found.ends.unbind(1))
        middle = torch.lerp(first, last, (0.5 * (pieces.start + pieces.end))[:, None])
        dx, dy = (last - first).unbind(1)
        outward = torch.nn.functional.normalize(torch.stack((-dy, dx), 1), dim=1)
        x, y = ((middle + _BESIDE_PX * outward + 0.5) * SAMPLES).long().unbind(1)
        x, y = x.clamp(0, width * SAMPLES - 1), y.clamp(0, height * SAMPLES - 1)
        picture = pieces.row // height
        fine = depth.new_zeros(count * height * width * SAMPLES**2).index_copy_(
            0, samples.place, samples.depth.detach()
        )
        behind = fine.index_select(0, (picture * height * SAMPLES + y) * width * SAMPLES + x)
        hides = torch.where(behind > own, own - behind, 0.0)
        return torch.where(found.is_outer, own - depth.reshape(-1).index_select(0, found.pixel), hides)


def _edge_depth(placed: PlacedMeshes) -> Float[Tensor, "pieces"]:
    """Depth of the edges in the middle of their pieces."""
    found = placed.boundary
    first, last = (placed.nearness.reshape(-1).index_select(0, end) for end in found.ends.unbind(1))
    return placed.depth_of(torch.lerp(first, last, 0.5 * (found.pieces.start + found.pieces.end)))
