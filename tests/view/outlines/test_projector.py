"""The projector ties its parts together: contours, cameras that are moved, sides."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.geometry import rotation_from_vector
from torchhand.view.outlines.outline import outline, outline_table
from torchhand.view.outlines.projector import HandProjector
from torchhand.view.outlines.visibility import visible_points


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_contour_is_outline_and_visibility(kind: str, scene: Any, generator: torch.Generator) -> None:
    projector = scene.projector(scene.camera(kind))
    pose, reference = scene.pose(generator)
    table = outline_table(3, 5)
    contour = projector.contour(pose, reference, table)
    torch.testing.assert_close(contour.points_px, projector.outline_px(pose, reference, table), atol=1e-9, rtol=0)
    primitives = scene.primitives(projector, pose, reference)
    seen = outline(primitives, table, is_orthographic=projector.is_orthographic)
    visible = visible_points(primitives, seen, table, is_orthographic=projector.is_orthographic)
    assert torch.equal(contour.visible, visible & (seen.points_cam[:, 2] > 0))
    torch.testing.assert_close(contour.normals.norm(dim=-1), torch.ones(table.size, dtype=torch.float64))


def test_a_moved_camera_sees_what_a_moved_hand_shows(scene: Any, generator: torch.Generator) -> None:
    """world_from_cam applied to both changes nothing."""
    camera = scene.camera()
    pose, reference = scene.pose(generator, 4)
    rotation = rotation_from_vector(torch.tensor((0.4, -0.2, 0.7), dtype=torch.float64))
    translation = torch.tensor((0.3, -0.1, 0.2), dtype=torch.float64)
    moved_camera = replace(camera, rotation=rotation, translation=translation)
    moved = pose.clone()
    moved[:, :3] = (pose[:, :3] - translation) @ rotation
    moved[:, 3:6] = pose[:, 3:6] @ rotation
    table = outline_table(3, 5)
    still = scene.projector(camera).outline_px(pose, reference, table)
    there = scene.projector(moved_camera).outline_px(moved, rotation.T @ reference, table)
    torch.testing.assert_close(there, still, atol=1e-8, rtol=0)
    one = scene.projector(moved_camera).silhouette(moved[0], rotation.T @ reference)
    other = scene.projector(camera).silhouette(pose[0], reference)
    assert float((one != other).double().mean()) < 1e-3


def test_visible_points_lie_in_the_silhouette(scene: Any, generator: torch.Generator) -> None:
    camera = scene.camera(width=640, height=480)
    projector = scene.projector(camera)
    pose, reference = scene.pose(generator)
    contour = projector.contour(pose, reference, outline_table(6, 8))
    inward = (contour.points_px - 1.5 * contour.normals)[contour.visible].round().long()
    mask = projector.silhouette(pose, reference)
    inside = (inward >= 0).all(-1) & (inward[:, 0] < 640) & (inward[:, 1] < 480)
    x, y = inward[inside].unbind(-1)
    assert float(mask[y, x].double().mean()) > 0.98


def test_a_shape_per_hand(scene: Any, generator: torch.Generator) -> None:
    base = scene.projector(scene.camera())
    kinematics, camera = base.kinematics, base.camera
    noise = torch.randn(3, len(kinematics.default_shape), generator=generator, dtype=torch.float64)
    shapes = kinematics.default_shape * (1 + 0.05 * noise)
    pose, reference = scene.pose(generator, 3)
    table = outline_table(2, 3)
    together = HandProjector(kinematics, camera, shapes).outline_px(pose, reference, table)
    alone = [
        HandProjector(kinematics, camera, s).outline_px(p, reference, table) for s, p in zip(shapes, pose, strict=True)
    ]
    torch.testing.assert_close(together, torch.stack(alone), atol=1e-9, rtol=0)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("kind", "lens"), [("pinhole", 0), ("pinhole", 5), ("orthographic", 0)])
def test_along_its_own_normals_a_hand_is_where_its_contour_is(
    kind: str, lens: int, side: str, scene: Any, generator: torch.Generator
) -> None:
    projector = scene.projector(scene.camera(kind, lens=lens), side)
    poses, reference = scene.pose(generator, 3)
    hands = scene.primitives(projector, poses, reference)
    own, table = replace(hands, rotation=hands.rotation[0], position=hands.position[0]), outline_table(3, 5)
    contour = projector.contour_of(own, table)
    seen = table.select(contour.visible)
    points, normals = contour.points_px[contour.visible], contour.normals[contour.visible]
    along = projector.along_normals_px(hands, projector.generators_of(hands), seen, normals)
    assert along.shape == (3, seen.size)
    torch.testing.assert_close(along[0], (points * normals).sum(-1), atol=1e-8, rtol=0)


@pytest.mark.parametrize(("kind", "side"), [("pinhole", "right"), ("pinhole", "left"), ("orthographic", "right")])
def test_other_hands_are_compared_where_their_bones_are_farthest(
    kind: str, side: str, scene: Any, generator: torch.Generator
) -> None:
    """By trying many points round each bone."""
    projector = scene.projector(scene.camera(kind), side)
    poses, reference = scene.pose(generator, 4)
    table = outline_table(3, 5)
    hands = scene.primitives(projector, poses, reference)
    normals = torch.nn.functional.normalize(torch.randn(table.size, 2, generator=generator, dtype=torch.float64))
    along = projector.along_normals_px(hands, projector.generators_of(hands), table, normals)

    angle = torch.linspace(0, 2 * torch.pi, 721, dtype=torch.float64)[:, None]
    cones, sizes = len(table.cone), hands.sizes
    start, length = sizes.cone_start[table.cone], sizes.cone_length[table.cone]
    radii = start * (1 + table.cone_fraction * (sizes.cone_end_scale[table.cone] - 1))[:, None]
    height = (length * table.cone_fraction).expand(len(angle), -1)
    ring = torch.stack((angle.cos() * radii[:, 0], height, angle.sin() * radii[:, 1]), -1)
    ring = torch.einsum("bpij,apj->bpai", hands.rotation[:, table.cone], ring) + hands.position[:, table.cone, None]
    whole = projector.generators_of(hands)[1].curve.movedim(-1, 0)[:, table.ellipsoid]  # hands, points, component, part
    circle = torch.cat((torch.ones_like(angle), angle.cos(), angle.sin()), -1)
    tried = torch.cat((ring, torch.einsum("bpic,ac->bpai", whole, circle)), 1)
    pixels = projector.camera.project(tried)
    expected = (pixels * normals[:, None]).sum(-1).amax(-1)
    torch.testing.assert_close(along, expected, atol=2e-3, rtol=0)

    fixed = projector.outline_px(poses, reference, table)[:, cones:]
    at_fixed_places = (fixed * normals[cones:]).sum(-1)
    assert float((along[:, cones:] - at_fixed_places).max()) > 3.0  # so there is something to tell apart
