"""A mesh with fewer faces on some of its own vertices, for pictures in which faces are smaller than a pixel."""

import heapq

import torch
from jaxtyping import Float, Int
from torch import Tensor

_TURN = 0.5  # cosine of the angle that a face may turn when an edge is taken out


def coarse_faces(
    vertices: Float[Tensor, "vertices 3"], faces: Int[Tensor, "faces 3"], count: int
) -> Int[Tensor, "coarse 3"]:
    """About `count` faces of a closed mesh, still closed: the shortest edges are taken out, one end moved to the other.

    Edges whose removal would turn a face far, or pinch the surface, stay. What moves the vertices moves the result.
    """
    place = vertices.double().tolist()
    around: list[set[tuple[int, int, int]]] = [set() for _ in place]
    for a, b, c in faces.tolist():
        for vertex in (a, b, c):
            around[vertex].add((a, b, c))
    queue = [_entry(place, a, b) for face in faces.tolist() for a, b in (face[:2], face[1:], face[::2])]
    heapq.heapify(queue)
    left = len(faces)
    while left > count and queue:
        _, kept, gone = heapq.heappop(queue)
        shared = around[kept] & around[gone]
        if len(shared) != 2 or _pinches(around, kept, gone):
            continue
        moved = {face: _with(face, gone, kept) for face in around[gone] - shared}
        if any(_turns(place, face, new) for face, new in moved.items()):
            continue
        for face in shared | set(moved):
            for vertex in face:
                around[vertex].discard(face)
        for new in moved.values():
            for vertex in new:
                around[vertex].add(new)
        left -= 2
        for vertex in {vertex for face in around[kept] for vertex in face} - {kept}:
            heapq.heappush(queue, _entry(place, kept, vertex))
    return torch.tensor(sorted({face for own in around for face in own}), device=faces.device)


def _entry(place: list[list[float]], one: int, other: int) -> tuple[float, int, int]:
    return sum((a - b) ** 2 for a, b in zip(place[one], place[other], strict=True)), one, other


def _pinches(around: list[set[tuple[int, int, int]]], kept: int, gone: int) -> bool:
    """Whether the ends have more neighbours in common than the two of their faces."""
    near, far = ({vertex for face in around[end] for vertex in face} - {kept, gone} for end in (kept, gone))
    return len(near & far) != 2


def _with(face: tuple[int, int, int], gone: int, kept: int) -> tuple[int, int, int]:
    a, b, c = (kept if vertex == gone else vertex for vertex in face)
    return a, b, c


def _turns(place: list[list[float]], old: tuple[int, int, int], new: tuple[int, int, int]) -> bool:
    one, other = _normal(place, old), _normal(place, new)
    lengths = sum(x * x for x in one) * sum(x * x for x in other)
    return sum(x * y for x, y in zip(one, other, strict=True)) < _TURN * lengths**0.5


def _normal(place: list[list[float]], face: tuple[int, int, int]) -> tuple[float, float, float]:
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (place[vertex] for vertex in face)
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
