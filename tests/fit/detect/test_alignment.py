"""A posture laid over silhouettes of people at random places, angles, sizes and sides is found again."""

import itertools
import math
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit.detect.alignment import Alignment, align_points, align_posture
from torchhand.fit.detect.facing import facing_rotation, turned_in_picture
from torchhand.geometry import Camera
from torchhand.hand import posture
from torchhand.simulate import facing, sample_shape
from torchhand.simulate.scene import cast_forearm

SIDES = list(itertools.product(("right", "left"), ("palm", "back")))


def _angle_between_deg(one: Tensor, other: Tensor) -> float:
    cosine = 0.5 * (torch.trace(one @ other.T) - 1)
    return math.degrees(math.acos(float(cosine.clamp(-1, 1))))


def _assert_found(best: Alignment, placed: Any, facing_name: str) -> None:
    assert best.facing == facing_name
    assert _angle_between_deg(best.root_reference, placed.root_reference) < 10
    frames = placed.kinematics(best.pose, placed.kinematics.default_shape, root_reference=best.root_reference)
    off = (placed.camera.project(frames.keypoints) - placed.keypoints_px).norm(dim=-1).mean()
    assert float(off) < 0.15 * placed.length_px
    assert best.pose[3:6].abs().max() == 0
    torch.testing.assert_close(best.root_reference @ best.root_reference.T, torch.eye(3, dtype=torch.float64))


@pytest.mark.parametrize("forearm", [False, True], ids=["hand", "forearm"])
@pytest.mark.parametrize(("side", "view"), SIDES)
def test_a_sampled_hand_is_found_again(side: Any, view: Any, forearm: bool, studio: Any) -> None:
    number = SIDES.index((side, view)) + 4 * forearm
    generator = torch.Generator().manual_seed(number)
    kinematics = studio.kinematics(side)
    shape = sample_shape(kinematics.shape_space, generator, spread=0.6)
    chance = torch.rand(4, generator=generator).tolist()
    placed = studio.placed(
        side=side,
        view=view,
        shape=shape,
        angle_deg=120 * (chance[0] - 0.5) + (180 if number % 3 == 0 and not forearm else 0),
        size=0.45 + 0.2 * chance[1],
        at=(0.3 * (chance[2] - 0.5), 0.1 * (chance[3] - 0.5)),
    )
    mask = placed.mask
    if forearm:
        frames = placed.projector.frames(placed.pose, placed.root_reference)
        arm = cast_forearm(frames, kinematics.shape_space, shape, placed.camera).mask
        assert int((arm & ~mask).sum()) > 0.2 * int(mask.sum())
        mask = mask | arm
    found = align_posture(
        mask, placed.camera, kinematics, kinematics.default_shape, posture("open", dtype=torch.float64)
    )
    _assert_found(found[0], placed, view)
    costs = [one.cost for one in found]
    assert costs == sorted(costs)
    assert costs[0] < 0.3


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_wrist_cut_by_the_edge_of_the_picture(side: str, studio: Any) -> None:
    placed = studio.placed(side=side, view="palm", size=0.7, at=(0.1, 0.22), angle_deg=8.0)
    wrist = placed.keypoints_px[0]
    assert float(wrist[1]) > placed.camera.height  # it is out of the picture
    found = align_posture(
        placed.mask,
        placed.camera,
        placed.kinematics,
        placed.kinematics.default_shape,
        posture("open", dtype=torch.float64),
    )
    _assert_found(found[0], placed, "palm")


def test_a_pointing_hand_is_found_with_its_posture(studio: Any) -> None:
    placed = studio.placed(view="back", posed="point", angle_deg=-35.0)
    found = align_posture(
        placed.mask, placed.camera, placed.kinematics, placed.shape, posture("point", dtype=torch.float64)
    )
    _assert_found(found[0], placed, "back")


def test_placements_are_distinct_and_limited(studio: Any) -> None:
    placed = studio.placed(angle_deg=20.0)
    arguments = (placed.mask, placed.camera, placed.kinematics, placed.shape, posture("open", dtype=torch.float64))
    three = align_posture(*arguments, keep=3)
    assert len(three) == 3
    for one, other in itertools.combinations(three, 2):
        is_turned = _angle_between_deg(one.root_reference, other.root_reference) > math.degrees(0.1)
        is_apart = float((one.pose[:3] - other.pose[:3]).norm()) > 0.005
        assert is_turned or is_apart


@pytest.mark.parametrize("size", [0, 3])
def test_nothing_in_an_empty_silhouette(size: int, studio: Any) -> None:
    camera, kinematics = studio.camera(), studio.kinematics()
    mask = torch.zeros(camera.height, camera.width, dtype=torch.bool)
    mask[50 : 50 + size, 60 : 60 + size] = True
    assert align_posture(mask, camera, kinematics, kinematics.default_shape, posture("open", dtype=torch.float64)) == []


def test_a_picture_that_is_all_hand_is_no_error(studio: Any) -> None:
    camera, kinematics = studio.camera(), studio.kinematics()
    mask = torch.ones(camera.height, camera.width, dtype=torch.bool)
    found = align_posture(mask, camera, kinematics, kinematics.default_shape, posture("open", dtype=torch.float64))
    assert all(one.cost > 0.5 for one in found)


@pytest.mark.parametrize("kind", ["pinhole", "lens", "orthographic"])
@pytest.mark.parametrize("side", ["right", "left"])
def test_wrist_and_fingertip_lie_on_the_points(side: str, kind: str, studio: Any) -> None:
    camera: Camera = studio.camera(kind="orthographic" if kind == "orthographic" else "pinhole", lens=kind == "lens")
    kinematics = studio.kinematics(side)
    wrist, tip = (70.0, 130.0), (112.0, 44.0)
    found = align_points(wrist, tip, camera, kinematics, kinematics.default_shape, posture("open", dtype=torch.float64))
    assert [one.facing for one in found] == ["palm", "back"]
    for one in found:
        frames = kinematics(one.pose, kinematics.default_shape, root_reference=one.root_reference)
        pixels = camera.project(frames.keypoints)[[0, 12]]
        if kind == "orthographic":  # the scale is the camera's: the wrist and the direction remain
            given = torch.tensor(tip, dtype=torch.float64) - torch.tensor(wrist, dtype=torch.float64)
            torch.testing.assert_close(pixels[0], torch.tensor(wrist, dtype=torch.float64))
            along = pixels[1] - pixels[0]
            torch.testing.assert_close(along / along.norm(), given / given.norm())
        else:
            expected = torch.tensor((wrist, tip), dtype=torch.float64)
            torch.testing.assert_close(pixels, expected, rtol=0, atol=1e-6)


def test_two_points_that_are_one(studio: Any) -> None:
    kinematics = studio.kinematics()
    with pytest.raises(ValueError, match="start points: expected two different points"):
        align_points(
            (3.0, 4.0),
            (3.0, 4.0),
            studio.camera(),
            kinematics,
            kinematics.default_shape,
            posture("open", dtype=torch.float64),
        )


def test_facings(studio: Any) -> None:
    for side in ("palm", "back"):
        torch.testing.assert_close(facing_rotation(side), facing(side), rtol=0, atol=0)  # as the simulator has them
    with pytest.raises(ValueError, match=r"facing: expected one of palm, back, got 'edge'"):
        facing_rotation("edge")
    quarter = turned_in_picture(facing_rotation("palm"), math.pi / 2)
    fingers = quarter @ torch.tensor((0.0, 1.0, 0.0), dtype=torch.float64)
    torch.testing.assert_close(fingers, torch.tensor((1.0, 0.0, 0.0), dtype=torch.float64))  # up turned to the right
