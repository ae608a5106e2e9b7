"""Hypotheses for a hand that the prediction does not explain."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, FINGERS, HandPose, posture
from torchhand.track.extended.proposals import finger_proposals, posture_proposals, turned_proposals


def _pose(placed: Any) -> HandPose:
    return HandPose(dofs=placed.pose, reference=placed.root_reference)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_a_hand_turned_and_moved_is_among_the_turned_ones(studio: Any, kind: str) -> None:
    camera = studio.camera(kind=kind)
    before = studio.placed(posed="point", camera=camera, size=0.5, at=(-0.2, 0.1))
    size = 0.5 if kind == "orthographic" else 0.6
    after = studio.placed(posed="point", camera=camera, size=size, at=(0.15, -0.05), angle_deg=60.0)
    starts = turned_proposals(_pose(before), before.mask, after.mask, camera)
    assert starts is not None
    drawn = [
        replace(before, pose=dofs, root_reference=reference)
        for dofs, reference in zip(starts.dofs, starts.reference, strict=True)
    ]
    off = torch.stack([(one.keypoints_px - after.keypoints_px).norm(dim=-1).mean() for one in drawn])
    assert float((before.keypoints_px - after.keypoints_px).norm(dim=-1).mean()) > 50
    length_px = size * camera.height  # of the hand with its fingers straight
    assert float(off.min()) < 0.07 * length_px  # 13 mm of a hand's 190: registration reaches that far
    assert int(off.argmin()) == 4  # of 24, 15° apart


def test_a_rotation_vector_counts_as_part_of_the_orientation(studio: Any) -> None:
    placed = studio.placed(angle_deg=20.0)
    vector = torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64)
    pose = placed.pose.clone()
    pose[3:6] = vector
    about_it = turned_proposals(_pose(replace(placed, pose=pose)), placed.mask, placed.mask, placed.camera)
    flat = turned_proposals(
        HandPose(dofs=placed.pose, reference=rotation_from_vector(vector) @ placed.root_reference),
        placed.mask,
        placed.mask,
        placed.camera,
    )
    assert about_it is not None
    assert flat is not None
    torch.testing.assert_close(about_it.reference, flat.reference, atol=1e-12, rtol=0)
    assert not bool(about_it.dofs[:, 3:6].any())
    torch.testing.assert_close(about_it.dofs[0, :3], placed.pose[:3], atol=1e-12, rtol=0)


def test_without_a_silhouette_there_are_none(studio: Any) -> None:
    placed = studio.placed()
    empty = torch.zeros_like(placed.mask)
    assert turned_proposals(_pose(placed), placed.mask, empty, placed.camera) is None
    assert turned_proposals(_pose(placed), empty, placed.mask, placed.camera) is None


def test_the_distance_follows_the_palms_size_within_bounds(studio: Any) -> None:
    near, far = studio.placed(size=0.75), studio.placed(size=0.25)
    starts = turned_proposals(_pose(near), near.mask, far.mask, near.camera)
    assert starts is not None
    assert math.isclose(float(starts.dofs[0, 2] / near.pose[2]), 1.4, rel_tol=0.02)  # and not 3


def test_other_postures_and_fingers_leave_the_rest_alone() -> None:
    start, pose = posture("open", dtype=torch.float64), posture("fist", dtype=torch.float64)
    pose[:6] = torch.arange(6.0)
    hand = HandPose.of(pose, torch.eye(3, dtype=pose.dtype))
    whole = posture_proposals(hand, start, ("flat", "point")).dofs
    assert whole.shape == (3, len(DOFS))
    assert bool((whole[:, :6] == pose[:6]).all())
    torch.testing.assert_close(whole[0, 6:], start[6:])
    torch.testing.assert_close(whole[1, 6:], posture("flat", dtype=torch.float64)[6:])
    single = finger_proposals(hand, start).dofs
    assert single.shape == (2 * len(FINGERS), len(DOFS))
    for i, finger in enumerate(FINGERS):
        own = torch.tensor([name.startswith(finger) for name in DOFS])
        for one in single[2 * i : 2 * i + 2]:
            assert torch.equal(one[~own], pose[~own])
            assert bool((one[own] != pose[own]).any())
        assert torch.equal(single[2 * i][own], start[own])
