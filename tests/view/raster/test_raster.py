"""The z-buffer against rays with triangles one by one, closed forms, and the ray caster of the primitives."""

from dataclasses import replace
from typing import Any

import pytest
import torch
import trimesh
from torch import Tensor

from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import ELLIPSOID_NAMES, PRIMITIVE_NAMES
from torchhand.view.raster.raster import mesh_silhouette, rasterize
from torchhand.view.raster.raycast import raycast, shade
from torchhand.view.raster.triangles import NEAREST

CAMERAS = [("pinhole", 0), ("pinhole", 5), ("pinhole", 8), ("orthographic", 0)]


def _pixels(camera: Camera) -> Tensor:
    rows, columns = (torch.arange(n, dtype=torch.float64) for n in (camera.height, camera.width))
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1).reshape(-1, 2)


def plain_rasterize(vertices: Tensor, faces: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """The specification: depth and face of the first meeting of every pixel's ray (Möller and Trumbore 1997)."""
    a, b, c = camera.cam_from_world(vertices)[faces].unbind(1)
    first, second = b - a, c - a
    depth, face = [], []
    for origin, direction in zip(*camera.rays(_pixels(camera)), strict=True):
        across = torch.linalg.cross(direction.expand_as(second), second)
        determinant = (first * across).sum(-1)
        arm = origin - a
        u = (arm * across).sum(-1) / determinant
        along = torch.linalg.cross(arm, first)
        v = (direction * along).sum(-1) / determinant
        t = (second * along).sum(-1) / determinant
        is_hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= NEAREST)
        t = torch.where(is_hit, t, torch.inf)
        depth.append(t.min())
        face.append(torch.where(is_hit.any(), t.argmin(), -1))
    size = (camera.height, camera.width)
    return torch.stack(depth).reshape(size), torch.stack(face).reshape(size)


def _soup(generator: torch.Generator, count: int, depth: float) -> tuple[Tensor, Tensor]:
    """Triangles at random around the camera's axis: some tiny, some wider than the picture."""
    centre = torch.randn(count, 1, 3, generator=generator, dtype=torch.float64) * torch.tensor((0.15, 0.12, 0.1))
    centre[..., 2] += depth
    size = 0.15 * torch.rand(count, 1, 1, generator=generator, dtype=torch.float64) ** 2
    corners = centre + size * torch.randn(count, 3, 3, generator=generator, dtype=torch.float64)
    return corners.reshape(-1, 3), torch.arange(3 * count).reshape(-1, 3)


def _moved(camera: Camera, *, out_of_the_way: float = 0.01) -> Camera:
    turn = rotation_from_vector(torch.tensor((0.05, 0.1, 0.3), dtype=torch.float64))
    return replace(camera, rotation=turn, translation=torch.tensor((out_of_the_way, 0.0, 0.0), dtype=torch.float64))


def _ball(subdivisions: int) -> tuple[Tensor, Tensor]:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    return torch.tensor(ball.vertices), torch.tensor(ball.faces)


@pytest.mark.parametrize(("kind", "lens"), CAMERAS)
@pytest.mark.parametrize("depth", [0.4, 0.08])
def test_equals_rays_with_triangles_one_by_one(kind: str, lens: int, depth: float, scene: Any) -> None:
    """At 0.08 m a third of the corners lie behind the camera, so that faces are cut."""
    for seed in range(2):
        generator = torch.Generator().manual_seed(seed)
        camera = _moved(scene.camera(kind, lens=lens, width=48, height=36))
        vertices, faces = _soup(generator, 40, depth)
        cast = rasterize(vertices, faces, camera)
        expected, face = plain_rasterize(vertices, faces, camera)
        assert torch.equal(cast.mask, face >= 0)
        assert 0.2 < float(cast.mask.double().mean()) < 1 or depth < 0.1
        torch.testing.assert_close(cast.depth, expected, atol=1e-9, rtol=1e-9)
        torch.testing.assert_close(cast.part, face)
        a, b, c = camera.cam_from_world(vertices)[faces[face[cast.mask]]].unbind(1)
        normal = torch.linalg.cross(b - a, c - a)
        torch.testing.assert_close(cast.normal[cast.mask], torch.nn.functional.normalize(normal, dim=-1))
        assert bool((cast.normal[~cast.mask] == 0).all())
        assert torch.equal(mesh_silhouette(vertices, faces, camera), cast.mask)


@pytest.mark.parametrize(("kind", "lens"), CAMERAS)
def test_equals_the_ray_caster_of_an_ellipsoid(kind: str, lens: int, scene: Any) -> None:
    """A fine mesh of one primitive, its normals mixed from the corners'."""
    camera = scene.camera(kind, lens=lens)
    projector = scene.projector(camera)
    i = len(PRIMITIVE_NAMES) - len(ELLIPSOID_NAMES) + ELLIPSOID_NAMES.index("thumb_thenar")
    placed = scene.primitives(projector, torch.zeros(36, dtype=torch.float64), torch.eye(3, dtype=torch.float64))
    position = torch.full((37, 3), -1.0, dtype=torch.float64)
    position[i] = torch.tensor((0.03, -0.01, 0.2))
    alone = replace(placed, position=position)
    exact = raycast(alone, camera)
    ball, faces = _ball(6)
    axes = placed.sizes.ellipsoid_axes[i - len(PRIMITIVE_NAMES)]
    turn = placed.rotation[i]
    vertices = position[i] + (ball * axes) @ turn.T
    cast = rasterize(vertices, faces, camera, vertex_normals=(ball / axes) @ turn.T, is_closed=True)
    differs = int((cast.mask != exact.mask).sum())
    assert differs <= 0.01 * int(exact.mask.sum())
    assert int(exact.mask.sum()) > 200
    both = cast.mask & exact.mask
    rays = torch.nn.functional.normalize(camera.rays(_pixels(camera))[1], dim=-1).reshape(*both.shape, 3)
    facing = (exact.normal * rays).sum(-1)[both] < -0.4
    sag = float(axes.max()) / 64**2  # a chord's height at 1/64 of a turn or so, twice over
    torch.testing.assert_close(cast.depth[both][facing], exact.depth[both][facing], atol=sag / 0.4, rtol=0)
    torch.testing.assert_close(cast.normal[both][facing], exact.normal[both][facing], atol=2e-3, rtol=0)
    flat = rasterize(vertices, faces, camera)
    assert float((flat.normal - exact.normal)[both][facing].abs().max()) > 4e-3, "one normal per face"
    torch.testing.assert_close(flat.depth, cast.depth)


@pytest.mark.parametrize(("kind", "lens"), CAMERAS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_cracks(kind: str, lens: int, dtype: torch.dtype, scene: Any, generator: torch.Generator) -> None:
    """A sheet of small triangles hides everything behind it, wherever its corners lie: some on pixel centres."""
    camera = scene.camera(kind, lens=lens, width=60, height=45).to(dtype=dtype)
    for spacing, jitter in ((1.0, 0.0), (0.7, 0.2), (3.1, 1.0), (2.0, 0.0)):
        side = int(90 / spacing)
        grid = torch.cartesian_prod(torch.arange(side), torch.arange(side)).to(dtype) * spacing - 10
        grid = grid + jitter * (torch.rand(grid.shape, generator=generator, dtype=dtype) - 0.5)
        start = torch.cartesian_prod(torch.arange(side - 1), torch.arange(side - 1)) @ torch.tensor((side, 1))
        quads = start[:, None] + torch.tensor((0, side, side + 1, 1))
        faces = torch.cat((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]))
        depth = 0.5 + 0.1 * torch.rand(len(grid), 1, generator=generator, dtype=dtype)
        plane = camera.plane_from_pixels(grid)
        vertices = torch.cat((plane if kind == "orthographic" else plane * depth, depth), -1)
        assert bool(mesh_silhouette(vertices, faces, camera).all())
        assert bool(mesh_silhouette(vertices, faces.flip(1), camera, is_closed=True).all()) != bool(
            mesh_silhouette(vertices, faces, camera, is_closed=True).all()
        )
        cast = rasterize(vertices, faces, camera)
        assert bool(cast.mask.all())
        assert float(cast.depth.min()) >= 0.5 - 1e-6
        assert float(cast.depth.max()) <= 0.6 + 1e-6


@pytest.mark.parametrize(("kind", "lens"), CAMERAS)
def test_a_closed_mesh_needs_no_faces_that_turn_away(kind: str, lens: int, scene: Any) -> None:
    ball, faces = _ball(2)
    for centre in ((0.02, 0.0, 0.3), (0.1, 0.05, 0.2), (0.0, 0.01, 0.05), (0.0, 0.0, -0.5)):  # the third: from within
        camera = scene.camera(kind, lens=lens, width=60, height=45)
        vertices = 0.07 * ball + torch.tensor(centre, dtype=torch.float64)
        whole, half = (rasterize(vertices, faces, camera, is_closed=is_closed) for is_closed in (False, True))
        assert torch.equal(whole.mask, half.mask)
        torch.testing.assert_close(whole.depth, half.depth)
        assert torch.equal(mesh_silhouette(vertices, faces, camera, is_closed=True), whole.mask)
        assert bool(whole.mask.any()) == (centre[2] > 0)


@pytest.mark.parametrize(("kind", "lens"), CAMERAS)
def test_a_ground_plane_that_reaches_behind_the_camera(kind: str, lens: int, scene: Any) -> None:
    """Two triangles many times wider than the picture: depth in closed form, below the horizon only."""
    camera = scene.camera(kind, lens=lens, width=60, height=45)
    height, slope = 0.05, 0.1  # y = height + slope z
    x, z = torch.tensor((-30.0, 30.0, 30.0, -30.0)).double(), torch.tensor((-20.0, -20.0, 20.0, 20.0)).double()
    vertices = torch.stack((x, height + slope * z, z), -1)
    cast = rasterize(vertices, torch.tensor(((0, 1, 2), (0, 2, 3))), camera)
    plane = camera.plane_from_pixels(_pixels(camera)).reshape(45, 60, 2)
    depth = (plane[..., 1] - height) / slope if kind == "orthographic" else height / (plane[..., 1] - slope)
    depth = torch.where((depth >= NEAREST) & (depth <= 20), depth, torch.inf)
    assert 0.1 < float(depth.isfinite().double().mean()) < 0.9
    torch.testing.assert_close(cast.depth, depth, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (0,)])
@pytest.mark.parametrize(("kind", "lens"), CAMERAS)
def test_silhouettes_of_a_batch_equal_a_loop(batch: tuple[int, ...], kind: str, lens: int, scene: Any) -> None:
    camera = scene.camera(kind, lens=lens, width=48, height=36).to(dtype=torch.float32)
    ball, faces = _ball(1)
    generator = torch.Generator().manual_seed(3)
    shift = torch.randn(*batch, 1, 3, generator=generator) * torch.tensor((0.1, 0.1, 0.15)) + torch.tensor((0, 0, 0.3))
    vertices = 0.05 * ball.float() + shift
    masks = mesh_silhouette(vertices, faces, camera)
    assert masks.shape == (*batch, 36, 48)
    loop = [rasterize(some, faces, camera).mask for some in vertices.reshape(-1, len(ball), 3)]
    assert torch.equal(masks.reshape(-1, 36, 48), torch.stack(loop) if loop else masks.reshape(-1, 36, 48))
    assert bool(masks.any()) == (0 not in batch)


def test_parts_and_shading(scene: Any) -> None:
    """Labels come from the table; a record like the ray caster's can be shaded."""
    camera = scene.camera(width=60, height=45)
    ball, faces = _ball(2)
    vertices = 0.05 * ball + torch.tensor((0.0, 0.0, 0.3), dtype=torch.float64)
    is_right = vertices[faces].mean(1)[:, 0] > 0
    cast = rasterize(vertices, faces, camera, part_of_face=torch.where(is_right, 7, 3).int())
    assert set(cast.part[:, :20].unique().tolist()) == {-1, 3}
    assert set(cast.part[:, 40:].unique().tolist()) == {-1, 7}
    picture = shade(cast, light=(-1.0, 0.0, -0.1), ambient=0.0)
    assert float(picture[22, 20:25].double().mean()) > 100 > float(picture[22, 36:40].double().mean())


def test_nothing_to_see(scene: Any) -> None:
    camera = scene.camera(width=20, height=10)
    ball, faces = _ball(1)
    lost = ball.clone()
    lost[:, 1] = torch.nan
    for vertices in (ball - 30, 0.1 * ball + torch.tensor((5.0, 0.0, 0.5)), lost, ball * torch.inf, 0 * ball + 0.5):
        cast = rasterize(vertices, faces, camera)
        assert not bool(cast.mask.any())
        assert bool(cast.depth.isinf().all())
        assert not bool(mesh_silhouette(vertices, faces, camera).any())


def test_faces_with_a_lost_corner_are_left_out(scene: Any) -> None:
    camera = scene.camera(width=40, height=30)
    ball, faces = _ball(1)
    vertices = 0.08 * ball + torch.tensor((0.0, 0.0, 0.4), dtype=torch.float64)
    holed = vertices.clone()
    nearest = int(vertices[:, 2].argmin())
    holed[nearest] = torch.nan
    kept = faces[(faces != nearest).all(-1)]
    torch.testing.assert_close(rasterize(holed, faces, camera).depth, rasterize(vertices, kept, camera).depth)


def test_one_camera_only(scene: Any) -> None:
    camera = scene.camera()
    names = ("intrinsics", "rotation", "translation", "distortion")
    batch = replace(camera, **{name: torch.stack([getattr(camera, name)] * 2) for name in names})
    with pytest.raises(ValueError, match=r"camera: expected one camera, got a batch of shape \(2,\)"):
        rasterize(torch.zeros(3, 3, dtype=torch.float64), torch.tensor(((0, 1, 2),)), batch)
