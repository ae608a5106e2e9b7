"""Other tilts of a hand that explains less than it did."""

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
from torchhand.track import Tracker, TrackerState, View
from torchhand.track.proposals import TiltedHands
from torchhand.track.scene import Candidate, Scene


def _turned_deg(one: Tensor, other: Tensor) -> float:
    return math.degrees(math.acos(max(-1.0, min(1.0, float(0.5 * ((one * other).sum() - 1))))))


@pytest.fixture(scope="module")
def half_closed(studio: Any) -> tuple[Tracker, TrackerState, Scene, HandPose, HandPose]:
    """A tracker, its state and what it sees of a hand that is half closed; that hand, and it tilted by 40 degrees."""
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
    tilted = HandPose(dofs=true.dofs, reference=turn @ true.rotation)
    state = replace(state, hand=tracker.parts.motion.started(tilted), best_score=1.0, frames_since_refit=1000)
    return tracker, state, tracker.scene(state, [View(image=picture)], 1.0), true, tilted


def _source(tracker: Tracker) -> TiltedHands:
    [found] = [one for one in tracker.parts.sources if isinstance(one, TiltedHands)]
    return found


def _followed(tracker: Tracker, scene: Scene, tilted: HandPose, shape: Tensor) -> Candidate:
    found = tracker.candidate(tilted, scene, shape)
    assert found is not None
    return replace(found, pose=tilted)


def test_the_tilt_is_among_those_that_are_proposed(half_closed: Any) -> None:
    tracker, state, scene, true, tilted = half_closed
    assert _turned_deg(true.rotation, tilted.rotation) > 35
    with torch.inference_mode():
        proposals = _source(tracker)(scene, state, _followed(tracker, scene, tilted, state.shape))
    assert 1 <= len(proposals.hands) <= 4
    assert min(_turned_deg(one.pose.rotation, true.rotation) for one in proposals.hands) < 12


def test_nothing_is_proposed_beside_a_detector_or_without_a_hand(half_closed: Any) -> None:
    tracker, state, scene, _, tilted = half_closed
    source = _source(tracker)
    followed = _followed(tracker, scene, tilted, state.shape)
    assert source(scene, state, None).hands == ()
    assert source(scene, state, replace(followed, keypoints=0.9)).hands == ()
    assert source(replace(scene, probabilities=(None,), masks=(None,)), state, followed).hands == ()


@pytest.mark.parametrize("name", ["contour_planar", "distance_full"])
def test_hands_that_are_rigid_or_sought_on_distance_maps_do_without(name: str, studio: Any) -> None:
    placed = studio.placed(size=0.7, camera=studio.camera(320, 240))
    tracker = Tracker(right_hand(), placed.camera, settings_of(name), shape=placed.shape)
    assert not any(isinstance(one, TiltedHands) for one in tracker.parts.sources)


def test_it_is_asked_seldom(half_closed: Any, studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hand that is never as good as it was, frame after frame."""
    tracker, state, scene, _, _ = half_closed
    asked: list[float] = []
    own = TiltedHands.__call__

    def count(self: TiltedHands, scene: Scene, state: TrackerState, best: Candidate | None) -> Any:
        asked.append(scene.time_s)
        return own(self, scene, state, best)

    monkeypatch.setattr("torchhand.track.proposals.tilted.TiltedHands.__call__", count)
    image = scene.views[0].image
    assert image is not None
    state = replace(state, time_s=0.0)
    for frame in range(1, 13):
        state, _ = tracker.step(replace(state, best_score=1.2), [View(image=image)], 0.04 * frame)
    assert 1 <= len(asked) <= 3
