"""Bones before a camera in few operations, against the kinematics; what DOFs do to them, against differences."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import BONES, DOFS, PARENTS, HandKinematics
from torchhand.view.contours.seen_bones import BonePlacer

STEP = 1e-6


def moved_camera(scene: Any) -> Camera:
    turn = rotation_from_vector(torch.tensor((0.1, -0.2, 0.3), dtype=torch.float64))
    return replace(scene.camera(), rotation=turn, translation=torch.tensor((0.02, -0.01, 0.1), dtype=torch.float64))


def hands(scene: Any, generator: torch.Generator, count: int, *, turn: float = 0.7) -> tuple[Tensor, Tensor]:
    """With rotation vectors of any length up to a few radians, and none."""
    pose, reference = scene.pose(generator, count)
    pose[:, 3:6] = turn * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    pose[0, 3:6] = 0.0
    tilt = rotation_from_vector(0.3 * torch.randn(count, 3, generator=generator, dtype=torch.float64))
    return pose, tilt @ reference


def shape_of(kinematics: HandKinematics, generator: torch.Generator) -> Tensor:
    factor = 1 + 0.05 * torch.randn(len(kinematics.default_shape), generator=generator, dtype=torch.float64)
    return kinematics.default_shape.double() * factor


@pytest.mark.parametrize("side", ["left", "right"])
def test_places_are_those_of_the_kinematics(side: str, scene: Any, generator: torch.Generator) -> None:
    kinematics = load_hand_model().kinematics("left" if side == "left" else "right", dtype=torch.float64)
    camera, shape = moved_camera(scene), shape_of(kinematics, generator)
    pose, reference = hands(scene, generator, 6)
    found = BonePlacer(kinematics, camera, shape, torch.float64)(pose, reference).cam_from_bone
    frames = kinematics(pose, shape, root_reference=reference)
    torch.testing.assert_close(found[..., :3], camera.rotation @ frames.rotation, atol=1e-12, rtol=0)
    torch.testing.assert_close(found[..., 3], camera.cam_from_world(frames.position), atol=1e-12, rtol=0)


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.7])
def test_screws_are_the_derivatives_of_the_places(turn: float, scene: Any, generator: torch.Generator) -> None:
    """At a rotation vector of zero, next to it and away from it."""
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    placer = BonePlacer(kinematics, moved_camera(scene), kinematics.default_shape, torch.float64)
    pose, reference = hands(scene, generator, 3, turn=turn)
    seen = placer(pose, reference)
    above = torch.eye(len(BONES), dtype=torch.bool)
    for bone in range(1, len(BONES)):
        above[bone] |= above[PARENTS[bone]]
    for dof in range(len(DOFS)):
        step = torch.zeros(len(DOFS), dtype=torch.float64)
        step[dof] = STEP
        ends = [placer(pose + sign * step, reference).cam_from_bone for sign in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * STEP)
        spin, shift = seen.screws[:, dof, :3], seen.screws[:, dof, 3:]
        rotation, place = seen.cam_from_bone[..., :3], seen.cam_from_bone[..., 3]
        turned = torch.linalg.cross(spin[:, None, :, None].expand_as(rotation), rotation, dim=2)
        moved = torch.linalg.cross(spin[:, None].expand_as(place), place) + shift[:, None]
        carried = torch.ones(len(BONES), dtype=torch.bool) if dof < 6 else above[:, kinematics.skeleton.bone[dof - 6]]
        expected = torch.where(carried[:, None, None], torch.cat((turned, moved[..., None]), -1), 0.0)
        torch.testing.assert_close(slope, expected, atol=1e-8, rtol=0)
