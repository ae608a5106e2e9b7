"""Hands that explain one picture, tilted hands among them, and the one that a second pass follows on."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.steps import right_hand, run
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose, posture
from torchhand.runs import settings_of
from torchhand.track import FurtherPass, Tracker, TrackerState, View
from torchhand.track.alternatives import TiltAlternatives
from torchhand.track.scene import HandKeypoints


def _turned_deg(one: Tensor, other: Tensor) -> float:
    return math.degrees(math.acos(max(-1.0, min(1.0, float(0.5 * ((one * other).sum() - 1))))))


@pytest.fixture(scope="module")
def half_closed(studio: Any) -> tuple[Tracker, TrackerState, View, HandPose, HandPose]:
    """A tracker, its state and a picture of a hand that is half closed; that hand, and it tilted by 40 degrees."""
    placed = studio.placed(size=0.7, view="palm", camera=studio.camera(320, 240))
    opened, fist = (posture(name, dtype=torch.float64)[6:] for name in ("open", "fist"))
    pose = placed.pose.clone()
    pose[6:] = 0.5 * (opened + fist)
    placed = replace(placed, pose=pose)
    tracker = Tracker(right_hand(), placed.camera, settings_of("contour_full"), shape=placed.shape)
    picture = placed.picture(seed=0)
    state, _ = run(tracker, [picture])
    true = HandPose(dofs=pose, reference=placed.root_reference).normalized()
    turn = rotation_from_vector(torch.tensor((math.radians(40.0), 0.0, 0.0)).double())
    return tracker, state, View(image=picture), true, HandPose(dofs=true.dofs, reference=turn @ true.rotation)


def _moved(tracker: Tracker, true: HandPose, tilted: HandPose, shape: Tensor) -> HandPose:
    """The tilted hand about the middle of the true one."""
    points = [
        tracker.kinematics(one.dofs, shape, root_reference=one.reference).keypoints.mean(0) for one in (true, tilted)
    ]
    dofs = tilted.dofs.clone()
    dofs[:3] += points[0] - points[1]
    return replace(tilted, dofs=dofs)


def test_the_likeliest_of_the_alternatives_to_a_tilted_hand_is_the_true_one(half_closed: Any) -> None:
    tracker, state, view, true, tilted = half_closed
    found = TiltAlternatives(tracker, state)(tracker.scene(state, [view], 1.0), [tilted, true])
    assert found is not None
    assert bool((found.cost.diff() >= 0).all())
    assert _turned_deg(found.pose.rotation[0], true.rotation) < 12
    apart = (found.keypoints[:, None] - found.keypoints).norm(dim=-1).mean(-1)
    assert float((apart + torch.eye(len(apart))).min()) > 0.004  # they differ
    assert float(found.cost[found.row[1]]) < float(found.cost[found.row[0]]) + 1e-9
    # Errors of neighbouring edges are one error: the contour tells them apart less.
    assert float(found.correlated_cost.max() - found.correlated_cost.min()) < float(found.cost[-1] - found.cost[0])


def test_there_are_none_beside_a_detector(half_closed: Any) -> None:
    tracker, state, view, true, _ = half_closed
    camera = tracker.own_cameras[0]
    points = tracker.kinematics(true.dofs, state.shape, root_reference=true.reference).keypoints
    seen = replace(view, keypoints=HandKeypoints(points_px=camera.project(points)))
    assert TiltAlternatives(tracker, state)(tracker.scene(state, [seen], 2.0), [true]) is None


@pytest.mark.parametrize(("name", "can"), [("contour_full", True), ("contour_planar", False), ("distance_full", False)])
def test_trackers_that_do_not_try_tilts_do_without(name: str, can: bool, studio: Any) -> None:
    placed = studio.placed(size=0.7, camera=studio.camera(320, 240))
    tracker = Tracker(right_hand(), placed.camera, settings_of(name), shape=placed.shape)
    assert TiltAlternatives.can_tilt(tracker) == can


def test_the_second_pass_leaves_a_tilt_that_is_less_likely(half_closed: Any) -> None:
    """The first pass ended in the tilted hand; the view from which it is followed back shows the true one."""
    tracker, state, view, true, tilted = half_closed
    start = _moved(tracker, true, tilted, state.shape).normalized()
    second = FurtherPass(tracker, state)
    found = second.step([view], 0.0, start.vector)
    assert found.estimate.pose is not None
    assert found.alternatives is not None
    assert found.evidence is not None
    assert found.evidence_before is not None
    own = HandPose.of(found.estimate.pose).rotation
    assert _turned_deg(start.rotation, true.rotation) > 35
    assert _turned_deg(own, true.rotation) < 15
    assert found.evidence >= found.evidence_before
