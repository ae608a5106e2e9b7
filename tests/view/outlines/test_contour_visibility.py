"""Visibility for registration against `visible_points`, which is asked twice."""

from typing import Any

import pytest
import torch

from torchhand.hand import Primitives
from torchhand.view.outlines.contour_visibility import Quadrics, seen_and_outer
from torchhand.view.outlines.outline import Outline, OutlineTable, outline, outline_table
from torchhand.view.outlines.visibility import visible_points

TABLE = outline_table(6, 7)
FAR = 1e3  # metres


def quadrics_of(primitives: Primitives) -> Quadrics:
    parts = primitives.implicit()
    last_first = {name: value.movedim(-1, 0) for name, value in vars(parts).items()}
    return Quadrics(**last_first)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
@pytest.mark.parametrize("hands", [1, 20])
def test_both_questions_are_answered_as_the_plain_version_does(
    kind: str, hands: int, scene: Any, generator: torch.Generator
) -> None:
    """Over random hands, more than are worked on at once; points behind the camera, too."""
    is_orthographic = kind == "orthographic"
    camera = scene.camera(kind)
    projector = scene.projector(camera)
    pose, reference = scene.pose(generator, hands)
    pose[1:2, 2] = 0.05  # partly behind the camera
    primitives = scene.primitives(projector, pose, reference)
    seen = outline(primitives, TABLE, is_orthographic=is_orthographic)
    is_real = seen.is_real & (seen.points_cam[..., 2] > 1e-3)
    plane = camera.plane_from_cam(seen.points_cam)
    beyond = plane + 0.01 * torch.randn(plane.shape, generator=generator, dtype=plane.dtype)
    found = seen_and_outer(
        quadrics_of(primitives),
        seen.points_cam.mT,
        beyond.mT,
        TABLE,
        is_real,
        is_orthographic=is_orthographic,
    )
    ahead = torch.cat((beyond, torch.ones_like(beyond[..., :1])), -1)
    far = ahead * (ahead.new_tensor((1.0, 1.0, FAR)) if is_orthographic else FAR)
    for result, points in zip(found, (seen.points_cam, far), strict=True):
        asked = Outline(points_cam=points, normals_cam=points, is_real=is_real)
        expected = visible_points(primitives, asked, TABLE, is_orthographic=is_orthographic)
        assert torch.equal(result, expected)
        assert 0.1 < float(result[0].double().mean()) < 0.9


def test_no_hands_are_no_mistake(scene: Any, generator: torch.Generator) -> None:
    projector = scene.projector(scene.camera())
    pose, reference = scene.pose(generator, 0)
    primitives = scene.primitives(projector, pose, reference)
    points, table = torch.zeros(0, 3, 4, dtype=torch.float64), few_points()
    is_real = torch.ones(0, 4, dtype=torch.bool)
    seen, outer = seen_and_outer(quadrics_of(primitives), points, points[:, :2], table, is_real)
    assert seen.shape == outer.shape == (0, 4)


def few_points() -> OutlineTable:
    keep = torch.zeros(TABLE.size, dtype=torch.bool)
    keep[:4] = True
    return TABLE.select(keep)
