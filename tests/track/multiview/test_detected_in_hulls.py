"""Detected keypoints before several cameras: one more observation in the hull, and a start."""

import pytest

from tests.fingertip import TIP
from tests.steps import FRAME_S
from torchhand.hand import DOFS, HandPose
from torchhand.runs import settings_of
from torchhand.track import HandKeypoints, Tracker, TrackerState, View
from torchhand.track.proposals import Proposals


@pytest.fixture(scope="module")
def scene(rig_hand, rig, pose_at, masks_of):
    """A hand that points, its silhouettes, and its keypoints in the world."""
    pose, reference = pose_at("point")
    keypoints = rig_hand.kinematics(pose, root_reference=reference).keypoints
    return HandPose(dofs=pose, reference=reference), masks_of((pose, reference)), keypoints


def _views(rig, masks, keypoints) -> list[View]:
    """With what a detector tells of points in the world; None for nothing."""
    if keypoints is None:
        return [View(mask=mask) for mask in masks]
    return [
        View(
            mask=mask,
            keypoints=HandKeypoints(
                points_px=camera.project(keypoints), points=camera.cam_from_world(keypoints) - 0.2, score=0.9
            ),
        )
        for mask, camera in zip(masks, rig, strict=True)
    ]


@pytest.mark.parametrize("config", ["hull_lm", "contour_full"])
def test_points_of_all_views_pull_the_fingertip(config: str, rig_hand, rig, scene) -> None:
    """A finger said to be bent by 0.15 rad more than it is, in every view: it goes some of the way."""
    at, masks, keypoints = scene
    bent = at.dofs.clone()
    bent[DOFS.index("index_mcp_fe")] += 0.15
    told = rig_hand.kinematics(bent, root_reference=at.reference).keypoints
    tips = []
    for seen in (keypoints, told):
        tracker = Tracker(rig_hand, rig, settings_of(config), shape=rig_hand.kinematics.default_shape)
        hand = tracker.parts.motion.started(at)
        state = TrackerState(shape=rig_hand.kinematics.default_shape, hand=hand, has_started=True)
        for frame in range(2):
            state, estimate = tracker.step(state, _views(rig, masks, seen), frame * FRAME_S)
            assert estimate.status == "tracked"
        assert estimate.keypoints is not None
        tips.append(estimate.keypoints[TIP])
    aside = told[TIP] - keypoints[TIP]
    moved = float((tips[1] - tips[0]) @ aside / (aside @ aside))
    assert 0.002 < moved < 1.0  # silhouettes of all sides object; without points there is no difference at all


@pytest.mark.parametrize("config", ["hull_lm", "contour_full"])
def test_a_hand_is_found_where_its_points_are(config: str, rig_hand, rig, scene, monkeypatch) -> None:
    """Without any search in the hull."""
    _, masks, keypoints = scene
    monkeypatch.setattr("torchhand.track.proposals.hull.HullSearch.occasion", "degraded")
    monkeypatch.setattr("torchhand.track.proposals.hull.HullSearch.__call__", lambda *_: pytest.fail("searched"))
    tracker = Tracker(rig_hand, rig, settings_of(config), shape=rig_hand.kinematics.default_shape)
    _, estimate = tracker.step(None, _views(rig, masks, keypoints), 0.0)
    assert estimate.status == "tracked"
    assert estimate.keypoints is not None
    assert float((estimate.keypoints - keypoints).norm(dim=-1).mean()) < 0.006


@pytest.mark.parametrize(("pictures", "is_asked"), [(0, True), (1, True), (2, False), (4, False)])
def test_nobody_else_is_asked_where_two_pictures_show_the_hand(
    pictures: int, is_asked: bool, rig_hand, rig, scene, monkeypatch
) -> None:
    """Of a hand that explains less than usual, but is where its detectors see it."""
    at, masks, keypoints = scene
    asked = set[str]()
    for name in ("SeenHands", "Turns", "Fingers", "Keyframes", "HullSearch"):
        source = f"torchhand.track.proposals.hull.{name}.__call__"
        monkeypatch.setattr(source, lambda self, *_, name=name: asked.add(name) or Proposals())
    shape = rig_hand.kinematics.default_shape
    tracker = Tracker(rig_hand, rig, settings_of("hull_lm"), shape=shape)
    hand = tracker.parts.motion.started(at)
    state = TrackerState(shape=shape, hand=hand, has_started=True, usual_score=1.2, frames_since_search=100)
    views = _views(rig, masks, keypoints)
    views = [view if row < pictures else View(mask=view.mask) for row, view in enumerate(views)]
    _, estimate = tracker.step(state, views, 0.0)
    assert estimate.status == "tracked"
    assert bool(asked) == is_asked
