"""Cutting closed triangle meshes into closed parts: by faces, and by planes."""

import numpy as np
from jaxtyping import Float64, Int

_ON_PLANE = 1e-10  # metres: a vertex nearer to a plane counts as above it


def closed_part(
    vertices: Float64[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Float64[np.ndarray, "w 3"], Int[np.ndarray, "g 3"]]:
    """Some faces of a closed mesh with their holes closed by fans to the holes' middles, and the vertices they use.

    Every edge of the result has two faces of opposite sense.
    """
    faces, source = _separated(faces)
    points = vertices[source]
    border = _border(faces)
    following = dict(zip(border[:, 1].tolist(), border[:, 0].tolist(), strict=True))  # against the faces' sense
    caps: list[tuple[int, int, int]] = []
    middles: list[np.ndarray] = []
    while following:
        start, after = next(iter(following.items()))
        loop = [start]
        while after != start:
            loop.append(after)
            after = following[after]
        for vertex in loop:
            del following[vertex]
        middle = len(points) + len(middles)
        middles.append(points[loop].mean(0))
        caps += [(loop[i], loop[(i + 1) % len(loop)], middle) for i in range(len(loop))]
    if middles:
        points = np.concatenate((points, np.stack(middles)))
        faces = np.concatenate((faces, np.array(caps, dtype=faces.dtype)))
    return np.ascontiguousarray(points), faces


def above_plane(
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    normal: Float64[np.ndarray, "3"],
    point: Float64[np.ndarray, "3"],
) -> tuple[Float64[np.ndarray, "w 3"], Int[np.ndarray, "g 3"]]:
    """The part of a closed mesh where normal · (x − point) >= 0, closed along the plane.

    Volume and moments are exact even where the section is not seen whole from its middle: the fan lies in the plane.
    """
    height = (vertices - point) @ normal
    height = np.where(np.abs(height) < _ON_PLANE, _ON_PLANE, height)
    points = list(vertices)
    crossings: dict[tuple[int, int], int] = {}

    def crossing(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in crossings:
            low, high = key
            fraction = height[low] / (height[low] - height[high])
            crossings[key] = len(points)
            points.append(vertices[low] + fraction * (vertices[high] - vertices[low]))
        return crossings[key]

    kept: list[tuple[int, ...]] = []
    for face in faces.tolist():
        corners: list[int] = []
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            if height[a] > 0:
                corners.append(a)
            if (height[a] > 0) != (height[b] > 0):
                corners.append(crossing(a, b))
        kept += [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
    return closed_part(np.stack(points), np.array(kept, dtype=faces.dtype).reshape(-1, 3))


def _border(faces: np.ndarray) -> np.ndarray:
    """Edges, as their faces go through them, that no other face goes through the other way."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    size = int(edges.max(initial=0)) + 1
    is_inner = np.isin(edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0])
    return edges[~is_inner]


def _separated(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces whose vertices each belong to one fan of neighbouring faces, and where each vertex comes from.

    A part of a surface may touch itself in a single vertex; its hole would go through that vertex twice. Such a vertex
    is doubled. Vertices that no face has are left out.
    """
    source, compact = np.unique(faces, return_inverse=True)
    result = compact.reshape(faces.shape)
    starts, times = np.unique(_border(result)[:, 0], return_counts=True)
    doubled: list[int] = []
    for vertex in starts[times > 1].tolist():
        around = np.flatnonzero((result == vertex).any(1)).tolist()
        for fan in _fans(result, vertex, around)[1:]:
            result[fan] = np.where(result[fan] == vertex, len(source) + len(doubled), result[fan])
            doubled.append(int(source[vertex]))
    return result, np.concatenate((source, np.array(doubled, dtype=source.dtype)))


def _fans(faces: np.ndarray, vertex: int, around: list[int]) -> list[list[int]]:
    """The faces around a vertex, in groups that hang together by edges at it."""
    corners = {}
    for i in around:
        face = faces[i].tolist()
        place = face.index(vertex)
        corners[i] = {face[(place + 1) % 3], face[place - 1]}
    fans, left = [], set(around)
    while left:
        fan, front = [], [left.pop()]
        while front:
            i = front.pop()
            fan.append(i)
            near = [j for j in left if corners[i] & corners[j]]
            left.difference_update(near)
            front += near
        fans.append(fan)
    return fans
