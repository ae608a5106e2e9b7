"""The ray caster against all rays with all primitives, dense sampling, a sphere, and the polygon silhouette."""

import importlib
import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.geometry import Camera, meet_rays, ray_table, rotation_from_vector
from torchhand.hand import ELLIPSOID_NAMES, PRIMITIVE_NAMES, Primitives, posture
from torchhand.view.outlines import outline, outline_table
from torchhand.view.raster.boxes import plane_boxes
from torchhand.view.raster.raycast import raycast, shade

KINDS = ("pinhole", "orthographic")
BACK = ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))


def _pixels(camera: Camera) -> Tensor:
    rows, columns = torch.arange(camera.height).double(), torch.arange(camera.width).double()
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1).reshape(-1, 2)


def plain_raycast(primitives: Primitives, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """The specification: depth, part and normal of every pixel's ray with every primitive's matrices."""
    moved = primitives.moved(camera.rotation, camera.translation)
    quadrics, clips = moved.quadrics()
    origins, directions = camera.rays(_pixels(camera))
    hits = meet_rays(ray_table(quadrics, origins, directions), ray_table(clips, origins, directions))
    near, part = hits.near.min(-1)
    point = origins + near.nan_to_num(posinf=0.0)[:, None] * directions
    chosen = quadrics[part]
    normal = torch.nn.functional.normalize(
        (chosen[:, :3, :3] @ point[..., None]).squeeze(-1) + chosen[:, :3, 3], dim=-1
    )
    is_hit = near.isfinite()
    size = (camera.height, camera.width)
    part = torch.where(is_hit, part, -1)
    return near.reshape(size), part.reshape(size), (normal * is_hit[:, None]).reshape(*size, 3)


@pytest.mark.parametrize(("kind", "lens"), [("pinhole", 0), ("pinhole", 5), ("pinhole", 8), ("orthographic", 0)])
@pytest.mark.parametrize("side", ["right", "left"])
def test_equals_the_plain_form(kind: str, lens: int, side: str, scene: Any) -> None:
    for seed in range(2):
        generator = torch.Generator().manual_seed(seed)
        camera = scene.camera(kind, lens=lens, width=60, height=45)
        projector = scene.projector(camera, side)
        pose, reference = scene.pose(generator)
        pose[0] += 0.05 * (seed - 1)  # partly outside the picture
        turn = rotation_from_vector(torch.tensor((0.0, 0.1, 0.3), dtype=torch.float64))
        world = scene.primitives(projector, pose, reference).moved(
            turn.T, -turn.T @ torch.tensor((0.01, 0.0, 0.0)).double()
        )
        camera = replace(camera, rotation=turn, translation=torch.tensor((0.01, 0.0, 0.0), dtype=torch.float64))
        cast = raycast(world, camera)
        depth, part, normal = plain_raycast(world, camera)
        assert torch.equal(cast.mask, part >= 0)
        assert 0.03 < float(cast.mask.double().mean()) < 0.9
        torch.testing.assert_close(cast.depth, depth, atol=1e-10, rtol=0)
        same = cast.part == part
        assert float(same.double().mean()) > 0.999, "only where two parts are equally near"
        torch.testing.assert_close(cast.normal[same], normal[same], atol=1e-7, rtol=0)


def inside_any(primitives: Primitives, points: Tensor) -> Tensor:
    """Whether points lie inside the union of the truncated primitives, by the values of their matrices."""
    quadrics, clips = primitives.quadrics()
    zero = torch.zeros_like(points)
    return ((ray_table(quadrics, points, zero)[2] < 0) & (ray_table(clips, points, zero)[2] >= 0)).any(-1)


def test_mask_is_where_dense_samples_are_inside(scene: Any, generator: torch.Generator) -> None:
    """Samples every millimetre: the mask holds them all and little more."""
    camera = scene.camera(width=32, height=24)
    projector = scene.projector(camera)
    primitives = scene.primitives(projector, *scene.pose(generator))
    origins, directions = camera.rays(_pixels(camera))
    depths = torch.arange(0.38, 0.62, 1e-3, dtype=torch.float64)
    inside = torch.stack([inside_any(primitives, origins + depth * directions) for depth in depths])
    sampled, cast = inside.any(0).reshape(24, 32), raycast(primitives, camera)
    assert not bool((sampled & ~cast.mask).any())
    assert int((cast.mask & ~sampled).sum()) <= 0.03 * int(cast.mask.sum())
    first = depths[inside.double().argmax(0)].reshape(24, 32)
    late = (first - cast.depth)[sampled]
    assert float(late.median()) == pytest.approx(0.5e-3, abs=0.3e-3)
    assert float((late < -1e-9).double().mean()) == 0


def test_depth_and_normals_of_a_sphere(scene: Any) -> None:
    """A finger's joint alone: the closed form for a sphere."""
    camera = scene.camera(width=64, height=48)
    projector = scene.projector(camera)
    pose = torch.zeros(36, dtype=torch.float64)
    primitives = scene.primitives(projector, pose, torch.eye(3, dtype=torch.float64))
    i = len(PRIMITIVE_NAMES) - len(ELLIPSOID_NAMES) + ELLIPSOID_NAMES.index("middle_pip")
    behind = torch.full((37, 3), -1.0, dtype=torch.float64)
    behind[i] = torch.tensor((0.01, -0.005, 0.06))
    alone = replace(primitives, position=behind)
    cast = raycast(alone, camera)
    assert set(cast.part.unique().tolist()) == {-1, i}
    centre, radius = behind[i], primitives.sizes.ellipsoid_axes[ELLIPSOID_NAMES.index("middle_pip"), 0]
    _, directions = camera.rays(_pixels(camera))
    a, b, c = (directions**2).sum(-1), directions @ centre, centre @ centre - radius**2
    depth = ((b - (b * b - a * c).sqrt()) / a).reshape(48, 64)
    torch.testing.assert_close(cast.mask, depth.isfinite())
    torch.testing.assert_close(cast.depth[cast.mask], depth[cast.mask], atol=1e-12, rtol=0)
    points = depth.reshape(-1, 1) * directions
    expected = ((points - centre) / radius).reshape(48, 64, 3)
    torch.testing.assert_close(cast.normal[cast.mask], expected[cast.mask], atol=1e-10, rtol=0)
    assert bool((cast.normal[~cast.mask] == 0).all())


@pytest.mark.parametrize(("kind", "lens"), [("pinhole", 0), ("pinhole", 5), ("orthographic", 0)])
def test_silhouette_is_the_mask(kind: str, lens: int, scene: Any) -> None:
    overlaps = []
    for seed in range(6):
        generator = torch.Generator().manual_seed(seed)
        camera = scene.camera(kind, lens=lens, width=240, height=180)
        projector = scene.projector(camera, "left" if seed % 2 else "right")
        pose, reference = scene.pose(generator)
        drawn = projector.silhouette(pose, reference)
        cast = raycast(scene.primitives(projector, pose, reference), camera).mask
        overlaps.append(float((drawn & cast).sum() / (drawn | cast).sum()))
        assert float(cast.double().mean()) > 0.03
    assert min(overlaps) > 0.97
    assert sum(overlaps) / len(overlaps) > 0.985


def test_boxes_hold_the_outline_tightly(scene: Any, generator: torch.Generator) -> None:
    """Outlines never leave their primitive's box, and a whole ellipsoid fills its own."""
    for kind in KINDS:
        projector = scene.projector(scene.camera(kind))
        primitives = scene.primitives(projector, *scene.pose(generator))
        table = outline_table(2, 64)
        seen = outline(primitives, table, is_orthographic=kind == "orthographic")
        plane = projector.camera.plane_from_cam(seen.points_cam)
        boxes = plane_boxes(primitives, is_orthographic=kind == "orthographic")
        mine = boxes[table.primitive]
        assert bool(((plane >= mine[:, :2] - 1e-12) & (plane <= mine[:, 2:] + 1e-12)).all(-1)[seen.is_real].all())
        i = PRIMITIVE_NAMES.index("index_pip")
        own = plane[table.primitive == i]
        filled = torch.cat((own.amin(0), own.amax(0)))
        torch.testing.assert_close(filled, boxes[i], atol=2e-3 * float((boxes[i, 2:] - boxes[i, :2]).max()), rtol=0)


def test_a_camera_within_the_hand_still_sees(scene: Any) -> None:
    """Parts that reach the camera's plane get the whole picture; nothing fails."""
    camera = scene.camera(width=40, height=30)
    projector = scene.projector(camera)
    pose = torch.zeros(36, dtype=torch.float64)
    pose[:3] = torch.tensor((0.0, -0.05, 0.01))
    world = scene.primitives(projector, pose, torch.eye(3, dtype=torch.float64))
    cast = raycast(world, camera)
    depth, part, _ = plain_raycast(world, camera)
    assert torch.equal(cast.mask, part >= 0)
    torch.testing.assert_close(cast.depth, depth, atol=1e-10, rtol=0)


def test_nothing_in_view(scene: Any) -> None:
    camera = scene.camera(width=20, height=10)
    projector = scene.projector(camera)
    for z in (-0.5, 0.5):
        pose = torch.zeros(36, dtype=torch.float64)
        pose[:3] = torch.tensor((30.0, 0.0, z))
        reference = torch.eye(3, dtype=torch.float64)
        cast = raycast(scene.primitives(projector, pose, reference), camera)
        assert not bool(cast.mask.any())
        assert bool(cast.depth.isinf().all())
        assert not bool(projector.silhouette(pose, reference).any())


def test_shade_lights_what_faces_the_light(scene: Any) -> None:
    camera = scene.camera(width=80, height=60)
    projector = scene.projector(camera)
    back = torch.tensor(BACK, dtype=torch.float64).T.contiguous()
    pose = posture("open", dtype=torch.float64)
    pose[:3] = torch.tensor((0.0, 0.09, 0.5))
    cast = raycast(scene.primitives(projector, pose, back), camera)
    background = torch.full((60, 80, 3), 7, dtype=torch.uint8)
    picture = shade(cast, background=background, light=(0.0, 0.0, -1.0), ambient=0.2, skin=(1.0, 0.5, 0.25))
    assert bool((picture[~cast.mask] == 7).all())
    brightness = 0.2 + 0.8 * (-cast.normal[..., 2]).clamp_min(0)
    torch.testing.assert_close(picture[cast.mask][:, 0].double(), 255 * brightness[cast.mask], atol=0.51, rtol=0)
    torch.testing.assert_close(picture[cast.mask][:, 1].double(), 127.5 * brightness[cast.mask], atol=0.51, rtol=0)
    grey = shade(cast)
    assert bool((grey[~cast.mask] == 128).all())
    assert math.isclose(float(cast.normal[cast.mask].norm(dim=-1).mean()), 1.0, abs_tol=1e-12)


def test_rays_that_are_not_held_together_meet_the_same(scene: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = scene.camera("pinhole", lens=0, width=60, height=45)
    projector = scene.projector(camera, "right")
    world = scene.primitives(projector, *scene.pose(torch.Generator().manual_seed(0)))
    together = raycast(world, camera)
    module = importlib.import_module("torchhand.view.raster.raycast")  # the door's name is the function
    monkeypatch.setattr(module, "_RAYS_AT_ONCE", 100)
    apart = raycast(world, camera)
    assert together.mask.any()
    for name in ("depth", "part", "normal"):
        assert torch.equal(getattr(apart, name), getattr(together, name)), name
