"""Closed parts of closed meshes: cut by faces and by planes."""

import numpy as np
import pytest
import trimesh

from torchhand.export.robots.closed_parts import above_plane, closed_part


def _octahedron() -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    return vertices, np.array(faces)


def test_both_sides_of_a_cut_add_up() -> None:
    vertices, faces = _octahedron()
    for chosen in ([0, 1, 2, 3], [0], [0, 1, 4], [0, 1, 2, 3, 4, 5, 6]):
        rest = [i for i in range(8) if i not in chosen]
        parts = [trimesh.Trimesh(*closed_part(vertices, faces[own]), process=False) for own in (chosen, rest)]
        assert all(part.is_watertight and part.is_winding_consistent for part in parts)
        assert sum(part.volume for part in parts) == pytest.approx(4 / 3, abs=1e-14)


def test_a_part_that_touches_itself_in_a_vertex() -> None:
    """Two opposite faces at the top have one vertex in common: two holes, not one of six corners."""
    vertices, faces = _octahedron()
    part = trimesh.Trimesh(*closed_part(vertices, faces[[0, 2]]), process=False)
    assert part.is_watertight
    assert part.body_count == 2
    assert len(part.vertices) == 8


def test_a_closed_mesh_stays_as_it_is() -> None:
    vertices, faces = _octahedron()
    points, same = closed_part(vertices, faces)
    assert np.array_equal(points[same], vertices[faces])


def test_a_cube_cut_by_a_plane() -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    vertices, faces = np.array(box.vertices), np.array(box.faces)
    normal = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)
    volumes = []
    for side in (-1.0, 1.0):
        part = trimesh.Trimesh(*above_plane(vertices, faces, side * normal, 0.1 * normal), process=False)
        assert part.is_watertight
        volumes.append(part.volume)
    assert sum(volumes) == pytest.approx(1.0, abs=1e-12)
    # inclusion and exclusion of the corners that a cube [0, 1]³ leaves below normal · x = d
    d = float(0.1 + normal @ np.full(3, 0.5))
    corners = np.stack(np.meshgrid(*[(0, 1)] * 3), -1).reshape(-1, 3)
    below = sum((-1.0) ** c.sum() * max(0.0, d - float(c @ normal)) ** 3 for c in corners) / (6 * normal.prod())
    assert volumes[0] == pytest.approx(below, abs=1e-12)


def test_planes_through_vertices_and_beside_the_mesh() -> None:
    vertices, faces = _octahedron()
    up = np.array([0.0, 0.0, 1.0])
    half = trimesh.Trimesh(*above_plane(vertices, faces, up, np.zeros(3)), process=False)
    assert half.is_watertight
    assert half.volume == pytest.approx(2 / 3, abs=1e-9)
    whole = trimesh.Trimesh(*above_plane(vertices, faces, up, np.array([0.0, 0.0, -2.0])), process=False)
    assert whole.volume == pytest.approx(4 / 3, abs=1e-14)
    assert len(above_plane(vertices, faces, up, np.array([0.0, 0.0, 2.0]))[1]) == 0
