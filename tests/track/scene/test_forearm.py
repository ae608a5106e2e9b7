"""What lies beyond the wrist of a hand looks like a forearm or like nothing; else it is no hand."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.steps import right_hand
from tests.studio import StagedHand
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandPose
from torchhand.simulate.scene import cast_forearm
from torchhand.track import Tracker, TrackerSettings
from torchhand.track.scene import Candidate, Health, Scene, View


def _arm(hand: StagedHand) -> Tensor:
    frames = hand.projector.frames(hand.pose, hand.root_reference)
    return cast_forearm(frames, hand.kinematics.shape_space, hand.shape, hand.camera).mask


def _below(hand: StagedHand, lengths: float) -> Tensor:
    """What is farther from the wrist towards the elbow than so many hand lengths."""
    x, y = torch.arange(hand.camera.width), torch.arange(hand.camera.height)[:, None]
    wrist, tip = hand.keypoints_px[0], hand.keypoints_px[12]
    along = (wrist - tip) / (wrist - tip).norm()
    return (x - wrist[0]) * along[0] + (y - wrist[1]) * along[1] > lengths * hand.length_px


def _candidate(hand: StagedHand, mask: Tensor) -> Candidate:
    """A posed hand after the tracker's own updates on a silhouette."""
    tracker = Tracker(right_hand(), hand.camera, TrackerSettings(pose_space="planar_scale"), shape=hand.shape)
    scene = Scene(views=(View(mask=mask),), masks=(mask,), probabilities=(mask.float(),), time_s=0.0)
    with torch.inference_mode():
        found = tracker.parts.rule.begin(HandPose.of(hand.pose, hand.root_reference), None, scene, hand.shape)
    assert found is not None
    return found


def _is_found(candidate: Candidate) -> bool:
    return Health(settings=TrackerSettings().health).is_found(candidate)


def _two_fingers(hand: StagedHand) -> StagedHand:
    """With index and middle finger side by side, the others bent."""
    pose = hand.pose.clone()
    pose[DOFS.index("index_mcp_aa")], pose[DOFS.index("middle_mcp_aa")] = -0.12, 0.0
    return replace(hand, pose=pose)


def _laid_over_two_fingers(hand: StagedHand, studio: Any, size: float) -> StagedHand:
    points = hand.keypoints_px
    tip, base = 0.5 * (points[8] + points[12]), 0.5 * (points[5] + points[9])
    middle, finger = 0.4 * base + 0.6 * tip, tip - base
    camera = hand.camera
    centre = 0.5 * torch.tensor((camera.width - 1, camera.height - 1), dtype=torch.float64)
    at = ((middle - centre) / camera.height).tolist()
    turn = math.degrees(math.atan2(float(finger[0]), -float(finger[1])))
    return studio.placed(camera=camera, posed="flat", size=size, at=tuple(at), angle_deg=turn)


@pytest.mark.parametrize("size", [0.40, 0.42, 0.44])
def test_a_whole_hand_over_two_fingers_is_none(size: float, studio: Any) -> None:
    large = _two_fingers(studio.placed(camera=studio.camera(320, 256), posed="victory", size=0.95, at=(0.0, 0.1)))
    candidate = _candidate(_laid_over_two_fingers(large, studio, size), large.mask)
    blind = replace(candidate, agreement=replace(candidate.agreement, beyond=torch.zeros(1)))
    assert _is_found(blind)  # by all that is on the fingers' side of its wrist
    assert not _is_found(candidate)


@pytest.mark.parametrize("posed", ["open", "point", "victory", "fist"])
@pytest.mark.parametrize("view", ["palm", "back"])
def test_a_hand_with_any_length_of_forearm_is_one(posed: str, view: Any, studio: Any) -> None:
    hand = studio.placed(camera=studio.camera(320, 256), posed=posed, view=view, size=0.55, at=(0.0, -0.12))
    arm = _arm(hand)
    beyond = []
    for seen in (0.0, 0.15, 0.35, 2.0):  # up to a sleeve, hand lengths
        candidate = _candidate(hand, hand.mask | (arm & ~_below(hand, seen)))
        assert _is_found(candidate)
        beyond.append(candidate.agreement.mean_beyond)
    assert max(beyond) < 0.02  # squares of the hand's length; a palm has some 0.2


def test_a_bent_wrist_is_a_wrist(studio: Any) -> None:
    hand = studio.placed(camera=studio.camera(320, 256), size=0.5, at=(0.0, -0.15))
    for angle_deg in (-30.0, 30.0):
        turn = rotation_from_vector(torch.tensor((0.0, 0.0, angle_deg), dtype=torch.float64).deg2rad())
        bent = replace(hand, root_reference=turn @ hand.root_reference)
        candidate = _candidate(hand, hand.mask | _arm(bent))
        assert candidate.agreement.mean_beyond < 0.03
        assert _is_found(candidate)


def test_the_mismatch_does_not_depend_on_the_pictures_size_and_turn(studio: Any) -> None:
    found = []
    for side, angle_deg in ((160, 0.0), (320, 0.0), (320, 90.0), (320, 37.0)):
        hand = studio.placed(camera=studio.camera(side, side), size=0.4, angle_deg=angle_deg)
        body = _below(hand, -0.02) & ~_below(hand, 0.55)  # as broad as the picture
        found.append(_candidate(hand, hand.mask | body).agreement.mean_beyond)
    assert max(found) - min(found) < 0.1 * max(found)


def test_a_fist_laid_on_the_arm_at_the_pictures_border_is_none(studio: Any) -> None:
    hand = studio.placed(camera=studio.camera(320, 480), posed="fist", size=0.4, at=(0.0, 0.48), angle_deg=180.0)
    arm = _arm(hand)
    further = torch.zeros_like(arm)
    further[:240, 150:170] = True
    assert bool(hand.mask[-1].any())
    assert not bool(arm[0].any())
    assert _is_found(_candidate(hand, hand.mask | arm & ~_below(hand, 0.6)))  # up to a sleeve
    assert _is_found(_candidate(hand, hand.mask | arm | further))  # to the other border
    assert not _is_found(_candidate(hand, hand.mask | arm))  # the hand is at the other end


def _upper_arm(hand: StagedHand, *, elbow: float, bend_deg: float, breadth: float) -> Tensor:
    """A bar from so many hand lengths beyond the wrist on, turned against the forearm."""
    wrist, tip = hand.keypoints_px[0], hand.keypoints_px[12]
    along = (wrist - tip) / (wrist - tip).norm()
    angle = math.radians(bend_deg)
    axis = torch.stack(
        (
            math.cos(angle) * along[0] - math.sin(angle) * along[1],
            math.sin(angle) * along[0] + math.cos(angle) * along[1],
        )
    )
    x, y = torch.arange(hand.camera.width), torch.arange(hand.camera.height)[:, None]
    start = wrist + elbow * hand.length_px * along
    on = (x - start[0]) * axis[0] + (y - start[1]) * axis[1]
    aside = (x - start[0]) * axis[1] - (y - start[1]) * axis[0]
    return (on >= 0) & (aside.abs() <= 0.5 * breadth * hand.length_px)


@pytest.mark.parametrize("bend_deg", [-120.0, -80.0, 80.0, 120.0])
def test_an_arm_may_bend_near_the_hand(bend_deg: float, studio: Any) -> None:
    hand = studio.placed(camera=studio.camera(320, 256), size=0.45, at=(0.0, -0.12))
    upper = _upper_arm(hand, elbow=0.5, bend_deg=bend_deg, breadth=0.38)
    candidate = _candidate(hand, hand.mask | (_arm(hand) & ~_below(hand, 0.6)) | upper)
    assert candidate.agreement.mean_beyond < 0.06
    assert _is_found(candidate)
