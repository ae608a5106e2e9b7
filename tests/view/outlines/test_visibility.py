"""Self-occlusion against its plain form over all pairs, and against what rays beside each point really meet."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.geometry import meet_rays, ray_table
from torchhand.hand import PRIMITIVE_NAMES, Primitives, posture
from torchhand.view.outlines.outline import Outline, OutlineTable, outline, outline_table, pixel_normals
from torchhand.view.outlines.visibility import DEFAULT_SLACK, visible_points

KINDS = ("pinhole", "orthographic")


def _rays(points: Tensor, kind: str) -> tuple[Tensor, Tensor, Tensor]:
    """Origin and direction of the ray through each point, and the point's depth along it."""
    if kind == "orthographic":
        towards = torch.tensor((0.0, 0.0, 1.0), dtype=points.dtype).expand_as(points)
        return points * (1 - towards), towards, points[..., 2]
    depth = points.norm(dim=-1)
    return torch.zeros_like(points), points / depth[..., None], depth


def plain_visible_points(primitives: Primitives, seen: Outline, table: OutlineTable, kind: str) -> Tensor:
    """The specification: every ray with every primitive's matrices."""
    origins, directions, depth = _rays(seen.points_cam, kind)
    quadrics, clips = primitives.quadrics()
    hits = meet_rays(ray_table(quadrics, origins, directions), ray_table(clips, origins, directions))
    own = torch.nn.functional.one_hot(table.primitive, len(PRIMITIVE_NAMES)).bool()
    hides = hits.is_hit & (hits.near < depth[..., None] - DEFAULT_SLACK)
    swallows = hits.is_hit & (hits.near < depth[..., None]) & (hits.far > depth[..., None]) & (hits.far > hits.near)
    return seen.is_real & (depth > 0) & ~((hides | swallows) & ~own).any(-1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
@pytest.mark.parametrize("side", ["right", "left"])
def test_equals_the_plain_form(
    kind: str, batch: tuple[int, ...], side: str, scene: Any, generator: torch.Generator
) -> None:
    projector = scene.projector(scene.camera(kind), side)
    primitives = scene.primitives(projector, *scene.pose(generator, *batch))
    table = outline_table(4, 6)
    orthographic = kind == "orthographic"
    seen = outline(primitives, table, is_orthographic=orthographic)
    visible = visible_points(primitives, seen, table, is_orthographic=orthographic)
    assert torch.equal(visible, plain_visible_points(primitives, seen, table, kind))
    assert 0.1 < float(visible.double().mean()) < 0.9


def _depths(primitives: Primitives, points: Tensor, kind: str) -> Tensor:
    """Depth of every primitive along the rays through points: (points, 37), infinite where it is not met."""
    origins, directions, _ = _rays(points, kind)
    quadrics, clips = primitives.quadrics()
    return meet_rays(ray_table(quadrics, origins, directions), ray_table(clips, origins, directions)).near


@pytest.mark.parametrize("kind", KINDS)
def test_visible_points_border_their_own_part(kind: str, scene: Any) -> None:
    """Just inside the outline the picture shows the part of a visible point, and another at a hidden point.

    Parts of one digit continue each other's surfaces, so of a visible point the digit is asked for; a few points lie
    where an occluder's own outline passes within a fifth of a pixel. Hidden points may lie under the skin of a joint.
    """
    camera = scene.camera(kind, width=640, height=480)
    projector = scene.projector(camera)
    table = outline_table(6, 8)
    digits = [name.split("_")[0] for name in PRIMITIVE_NAMES]
    digit = torch.tensor([digits.index(name) for name in digits])
    right, hidden_right, visible_count, hidden_count = 0, 0, 0, 0
    for seed in range(12):
        generator = torch.Generator().manual_seed(seed)
        primitives = scene.primitives(projector, *scene.pose(generator))
        seen = outline(primitives, table, is_orthographic=kind == "orthographic")
        visible = visible_points(primitives, seen, table, is_orthographic=kind == "orthographic")
        plane = camera.plane_from_cam(seen.points_cam)
        inward = camera.pixels_from_plane(plane) - 0.2 * pixel_normals(camera, plane, seen.normals_cam)
        spot = camera.plane_from_pixels(inward)
        depth = seen.points_cam[:, 2:]
        beside = torch.cat((spot if kind == "orthographic" else spot * depth, depth), -1)
        depths = _depths(primitives, beside, kind)
        nearest = depths.argmin(-1)
        is_nearest = nearest == table.primitive
        is_shown = digit[nearest] == digit[table.primitive]
        hidden = seen.is_real & ~visible
        right += int((is_shown & visible).sum())
        visible_count += int(visible.sum())
        hidden_right += int((~is_nearest & hidden).sum())
        hidden_count += int(hidden.sum())
    assert visible_count > 500
    assert hidden_count > 500
    assert right / visible_count > 0.995
    assert hidden_right / hidden_count > 0.95


def test_a_finger_behind_the_palm_is_hidden(scene: Any) -> None:
    """A fist seen from its back hides the middle and distal phalanges."""
    projector = scene.projector(scene.camera())
    back = torch.tensor(((0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)), dtype=torch.float64).T.contiguous()
    pose = posture("fist", dtype=torch.float64)
    pose[:3] = torch.tensor((0.0, 0.07, 0.5))
    table = outline_table(4, 6)
    contour = projector.contour(pose, back, table)
    for finger in ("middle", "ring"):
        for part in ("middle", "distal", "tip"):
            index = PRIMITIVE_NAMES.index(f"{finger}_{part}")
            assert not bool(contour.visible[table.primitive == index].any()), (finger, part)
    palm = contour.visible[table.primitive == PRIMITIVE_NAMES.index("palm")]
    assert bool(palm.any())


def test_slack_decides_about_grazing_occluders(scene: Any, generator: torch.Generator) -> None:
    projector = scene.projector(scene.camera())
    primitives = scene.primitives(projector, *scene.pose(generator))
    table = outline_table(6, 8)
    seen = outline(primitives, table)
    strict, loose = (visible_points(primitives, seen, table, slack=slack) for slack in (0.0, 1.0))
    assert bool((loose | ~strict).all()), "slack can only show more"
    assert int(loose.sum()) > int(strict.sum())
