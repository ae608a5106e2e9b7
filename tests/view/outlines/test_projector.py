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
