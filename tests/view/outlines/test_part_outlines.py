"""Outlines by matrices against `outline`, and quadrics against `Primitives.implicit`."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, posture
from torchhand.view.contours import BonePlacer
from torchhand.view.outlines.outline import outline, outline_table
from torchhand.view.outlines.part_outlines import PartOutlines
from torchhand.view.outlines.projector import HandProjector

TABLE = outline_table(5, 6, without=("palm_wrist", "index_middle"))
ATOL = 1e-12


def bones_of(projector: HandProjector, pose: Tensor, reference: Tensor) -> Tensor:
    placer = BonePlacer(projector.kinematics, projector.camera, projector.shape, torch.float64)
    return placer(pose, reference.expand(len(pose), 3, 3)).cam_from_bone


def outlines_of(projector: HandProjector) -> PartOutlines:
    is_left, is_orthographic = projector.kinematics.side == "left", projector.is_orthographic
    return PartOutlines(projector.sizes, TABLE, is_left=is_left, is_orthographic=is_orthographic)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_points_and_normals_are_those_of_the_outline(
    kind: str, side: str, scene: Any, generator: torch.Generator
) -> None:
    """Also where there is no outline: hands that hold the camera."""
    projector = scene.projector(scene.camera(kind), side)
    pose, reference = scene.pose(generator, 12)
    pose[-2:, :3] *= 0.02
    primitives = scene.primitives(projector, pose, reference)
    expected = outline(primitives, TABLE, is_orthographic=kind == "orthographic")
    outlines = outlines_of(projector)
    placed = outlines.placed(bones_of(projector, pose, reference))
    found = outlines(placed, with_normals=True)
    assert found.normals is not None
    assert found.is_real is not None
    torch.testing.assert_close(found.points.mT, expected.points_cam, atol=ATOL, rtol=0)
    # Not of unit length: up to thousands per metre.
    torch.testing.assert_close(found.normals.mT, expected.normals_cam, atol=1e-8, rtol=ATOL)
    assert torch.equal(found.is_real, expected.is_real)
    assert torch.equal(outlines(placed).points, found.points)
    if kind == "pinhole":
        assert 0.005 < float((~found.is_real).double().mean()) < 0.5


@pytest.mark.parametrize("side", ["left", "right"])
def test_quadrics_are_those_of_the_primitives(side: str, scene: Any, generator: torch.Generator) -> None:
    projector = scene.projector(scene.camera(), side)
    pose, reference = scene.pose(generator, 4)
    parts = scene.primitives(projector, pose, reference).implicit()
    outlines = outlines_of(projector)
    found = outlines.quadrics(outlines.placed(bones_of(projector, pose, reference)))
    for name, value in vars(found).items():
        expected = getattr(parts, name).movedim(-1, 0)
        torch.testing.assert_close(
            value, expected, atol=1e-9 * float(expected[expected.isfinite()].abs().max()), rtol=0
        )


def test_a_finger_that_points_at_the_camera_has_finite_outlines(scene: Any) -> None:
    """Seen exactly along its axis, and next to that."""
    projector = scene.projector(scene.camera())
    pose = posture("flat", dtype=torch.float64)[None].repeat(3, 1)
    root = projector.kinematics(pose[:1]).position[0]
    bone, ahead = [DOFS.index("index_mcp_aa"), 12], torch.tensor((0.0, 0.0, 0.5), dtype=torch.float64)
    towards = rotation_from_vector(torch.tensor((-torch.pi / 2, 0.0, 0.0), dtype=torch.float64))
    pose[:, bone[0]] = 0.0
    pose[:, :3] = ahead - root[bone[1]] @ towards.T
    pose[1:, 0] += torch.tensor((1e-12, 1e-7), dtype=torch.float64)
    outlines = outlines_of(projector)
    found = outlines(outlines.placed(bones_of(projector, pose, towards)), with_normals=True)
    assert found.normals is not None
    assert bool(found.points.isfinite().all())
    assert bool(found.normals.isfinite().all())
    expected = outline(scene.primitives(projector, pose, towards), TABLE)
    torch.testing.assert_close(found.points.mT, expected.points_cam, atol=1e-7, rtol=0)
