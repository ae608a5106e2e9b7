"""Surfaces, pictures and files of hulls: volumes, closedness, and what a camera sees of them."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import torch
import trimesh

from torchhand.errors import InputError
from torchhand.files import save_hull
from torchhand.view import mesh_silhouette, rasterize
from torchhand.volume.carving import carve
from torchhand.volume.carving_settings import CarvingSettings
from torchhand.volume.cube import RootCube
from torchhand.volume.octree import Octree
from torchhand.volume.picture import BACKGROUND, COLOUR, draw_hull
from torchhand.volume.surface import hull_mesh, hull_quads

CUBE = RootCube(centre=(0.01, -0.02, 0.005), side=0.256)
CENTRE = torch.tensor((0.02, -0.01, 0.0), dtype=torch.float64)


@pytest.fixture(scope="module")
def octree(rigs: Any) -> Octree:
    """Two balls apart; the second frame has no hull."""
    cameras = rigs.random(torch.Generator().manual_seed(5), 4)
    balls = torch.stack((CENTRE, CENTRE + torch.tensor((0.0, 0.06, 0.04))))
    masks = [rigs.ball(camera, balls, torch.tensor((0.04, 0.02))) for camera in cameras]
    both = [torch.stack((mask, torch.zeros_like(mask))) for mask in masks]
    return carve(both, cameras, CUBE, CarvingSettings(level=6))


def test_leaves_fill_the_volume_once(octree: Octree) -> None:
    leaves = octree.leaves(frame=0, dtype=torch.float64)
    assert float((leaves.sides**3).sum()) == pytest.approx(float(octree.volume()[0]), rel=1e-12)
    filled, _ = octree.occupancy()
    assert int(filled.sum()) * octree.leaf_side**3 == pytest.approx(float(octree.volume()[0]), rel=1e-12)
    low, high = leaves.centres - 0.5 * leaves.sides[:, None], leaves.centres + 0.5 * leaves.sides[:, None]
    corner = torch.tensor(CUBE.corner, dtype=torch.float64)
    assert bool((low >= corner - 1e-12).all())
    assert bool((high <= corner + CUBE.side + 1e-12).all())
    assert len(leaves.sides.unique()) > 1


def test_surface_is_closed_and_holds_the_volume(octree: Octree) -> None:
    vertices, faces = hull_mesh(octree)
    a, b, c = vertices[faces].unbind(1)
    assert float((a * torch.linalg.cross(b, c)).sum() / 6) == pytest.approx(float(octree.volume()[0]), rel=1e-9)
    edges = Counter(tuple(edge) for k in range(3) for edge in faces[:, [k, (k + 1) % 3]].tolist())
    assert all(edges[(v, u)] == number for (u, v), number in edges.items())
    vertices, quads, normals = hull_quads(octree)
    a, b, c, d = vertices[quads].unbind(1)
    across = torch.linalg.cross(b - a, d - a) / octree.leaf_side**2
    torch.testing.assert_close(across, normals.double(), atol=1e-9, rtol=0)
    torch.testing.assert_close(a + c, b + d, atol=1e-12, rtol=0)
    empty, quads, _ = hull_quads(octree, frame=1)
    assert len(empty) == len(quads) == 0


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_picture_shows_the_surface(kind: str, octree: Octree, rigs: Any) -> None:
    camera = rigs.looking((0.2, 0.3, -0.4), kind=kind)
    picture = draw_hull(octree, camera)
    drawn = (picture != torch.tensor(BACKGROUND, dtype=torch.uint8)).any(-1)
    seen = mesh_silhouette(*hull_mesh(octree), camera)
    around = torch.nn.functional.max_pool2d(seen.float()[None], 3, 1, 1)[0] > 0  # its edge is drawn as well
    assert int(seen.sum()) > 500
    assert bool((drawn <= around).all())
    assert bool((seen <= drawn).all())
    assert len(picture[drawn].unique(dim=0)) >= 3  # three sides of a cube look at the camera
    ground = torch.full((120, 160, 3), 200, dtype=torch.uint8)
    over = draw_hull(octree, camera, picture=ground)
    assert bool((over[~drawn] == 200).all())
    assert torch.equal(over[drawn], picture[drawn])
    assert bool((ground == 200).all())
    assert torch.equal(draw_hull(octree, camera, frame=1, picture=ground), ground)
    with pytest.raises(ValueError, match=r"picture: expected \(120, 160, 3\), got \(60, 160, 3\)"):
        draw_hull(octree, camera, picture=torch.zeros(60, 160, 3, dtype=torch.uint8))


def test_nearer_faces_hide_those_behind(octree: Octree, rigs: Any) -> None:
    """Every pixel has the brightness of the face that its ray meets first."""
    camera = rigs.looking((0.25, 0.3, -0.4), width=640, height=480, focal=700.0)
    picture = draw_hull(octree, camera).double() / torch.tensor(COLOUR)
    vertices, faces = hull_mesh(octree)
    cast = rasterize(vertices, faces, camera)
    _, direction = camera.rays(cast.mask.nonzero().flip(-1).double())
    facing = -(direction * cast.normal[cast.mask]).sum(-1) / direction.norm(dim=-1)
    expected = 0.35 + 0.65 * facing
    right = (picture[cast.mask].mean(-1) - expected).abs() < 0.02
    assert len(right) > 10_000
    assert float(right.double().mean()) > 0.8  # all but those along the edges of faces, which are 5 px wide


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_files_can_be_read_by_others(suffix: str, octree: Octree, tmp_path: Path) -> None:
    path = tmp_path / f"hull{suffix}"
    save_hull(octree, path)
    mesh = trimesh.load(path, force="mesh")
    assert isinstance(mesh, trimesh.Trimesh)
    assert float(mesh.volume) == pytest.approx(float(octree.volume()[0]), rel=1e-4)
    vertices, _ = hull_mesh(octree)
    assert mesh.bounds == pytest.approx(torch.stack((vertices.amin(0), vertices.amax(0))).numpy(), abs=1e-6)
    save_hull(octree, path, what="points")
    points: Any = trimesh.load(path)
    points = next(iter(points.geometry.values())) if suffix == ".glb" else points
    assert points.vertices == pytest.approx(octree.leaves(frame=0).centres.numpy(), abs=1e-6)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_says_what_is_wrong(octree: Octree, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ends with \.ply or \.glb, got '\.obj'"):
        save_hull(octree, tmp_path / "hull.obj")
    with pytest.raises(InputError, match="frame 1 has no hull to write"):
        save_hull(octree, tmp_path / "hull.ply", frame=1)
    with pytest.raises(InputError, match="cannot be written"):
        save_hull(octree, tmp_path / "no" / "hull.ply")
