"""Other tilts of a hand that explains less than it did."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.steps import right_hand, run
from torchhand.geometry import rotation_from_vector
from torchhand.hand import FINGERS, JOINT_DOFS, HandPose, posture
from torchhand.runs import settings_of
from torchhand.track import FurtherPass, TiltAlternatives, Tracker, TrackerState, View
from torchhand.track.alternatives import misplaced_nats
from torchhand.track.proposals import Proposals, Proposed, TiltedHands
from torchhand.track.proposals.digits import PlacedDigits, moved_digits, outside
from torchhand.track.proposals.tilted import exchanged_fingers
from torchhand.track.scene import Candidate, Scene

INDEX_ALONE, NO_DIGIT = (False, True, False, False, False), (False,) * 5
INDEX = torch.tensor([name.startswith("index") for name in JOINT_DOFS])


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


@pytest.fixture(scope="module")
def folded(studio: Any) -> tuple[Any, Tracker, TrackerState, Tensor, HandPose]:
    """A hand whose index bends between two pictures: it in the first, a tracker without a network's posture, its state
    after that, the second picture, and the hand in it."""
    placed = studio.placed(size=0.7, view="palm", camera=studio.camera(320, 240))
    opened, fist = (posture(name, dtype=torch.float64)[6:] for name in ("open", "fist"))
    straight, bent = placed.pose.clone(), placed.pose.clone()
    straight[6:], bent[6:] = opened, torch.where(INDEX, 0.7 * fist, opened)
    placed = replace(placed, pose=straight)
    settings = replace(settings_of("contour_full"), learned_posture=False)
    tracker = Tracker(right_hand(), placed.camera, settings, shape=placed.shape)
    state, _ = run(tracker, [placed.picture(seed=0)])
    picture = replace(placed, pose=bent).picture(seed=1)
    return placed, tracker, state, picture, HandPose(dofs=bent, reference=placed.root_reference)


def test_a_finger_outside_the_silhouette_is_proposed_bent(folded: Any) -> None:
    """The straight one that was followed lies beside the hand."""
    placed, tracker, state, picture, true = folded
    scene = tracker.scene(state, [View(image=picture)], 1.0)
    followed = HandPose(dofs=placed.pose, reference=placed.root_reference).normalized()
    best = _followed(tracker, scene, followed, placed.shape)
    plane = scene.plane(0)
    assert plane is not None
    hands = HandPose.stack([followed])
    (away,) = PlacedDigits(tracker.kinematics, placed.camera, hands, placed.shape, plane > 0.5).outside()
    assert away[1] > 0.5
    assert away[[0, 2, 3, 4]].max() < 0.2
    with torch.inference_mode():
        assert _source(tracker).misplaced(best, scene, placed.shape) == (*INDEX_ALONE, *NO_DIGIT)
        assert _source(tracker).misplaced(None, scene, placed.shape) == ()
        proposals = _source(tracker)(scene, state, best)
    bends = HandPose.stack([one.pose for one in proposals.hands]).dofs[:, 6:][:, INDEX].sum(-1)
    assert float((bends - true.dofs[6:][INDEX].sum()).abs().min()) < math.radians(60)
    assert float(bends.min()) < math.radians(60)  # others are there as well


@pytest.mark.parametrize("since", [0, 5])
def test_a_finger_that_comes_to_lie_outside_is_tried_bent_at_once(folded: Any, since: int) -> None:
    """Whatever else was tried in vain, but for the last frames."""
    _, tracker, state, picture, true = folded
    state = replace(state, frames_since_refit=since, refit_after=1000)
    assert state.time_s is not None
    after, estimate = tracker.step(state, [View(image=picture)], state.time_s + 0.04)
    assert after.frames_since_refit == (0 if since else 1)
    assert estimate.pose is not None
    off = float((estimate.pose[6:][INDEX] - true.dofs[6:][INDEX]).sum().abs())
    assert (off < math.radians(60)) == bool(since)
    assert after.digits_tried == ((*INDEX_ALONE, *NO_DIGIT) if since else ())


def test_a_finger_that_stays_outside_is_tried_once(folded: Any) -> None:
    _, tracker, state, picture, _ = folded
    state = replace(state, frames_since_refit=5, refit_after=1000, digits_tried=(*INDEX_ALONE, *NO_DIGIT))
    after, _ = tracker.step(state, [View(image=picture)], state.time_s + 0.04)
    assert after.frames_since_refit == 6


def test_a_finger_outside_the_silhouette_counts_against_a_hand(folded: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    placed, tracker, state, picture, _ = folded
    before = HandPose(dofs=placed.pose, reference=placed.root_reference).normalized()
    found = []
    for nats in (0.0, 4.5):
        monkeypatch.setattr("torchhand.track.alternatives._OUTSIDE_NATS", nats)
        second = FurtherPass(tracker, replace(state, frames_since_refit=5)).step(
            [View(image=picture)], 1.0, before.vector
        )
        assert second.evidence_before is not None
        found.append(second.evidence_before)
    assert found[0] - found[1] == pytest.approx(4.5)


@pytest.fixture(scope="module")
def stretched(studio: Any) -> tuple[Any, Tracker, TrackerState, Tensor, HandPose]:
    """A hand whose index is stretched between two pictures, as `folded`; and it as it was followed, bent."""
    placed = studio.placed(size=0.7, view="palm", camera=studio.camera(320, 240))
    opened, fist = (posture(name, dtype=torch.float64)[6:] for name in ("open", "fist"))
    straight, bent = placed.pose.clone(), placed.pose.clone()
    straight[6:], bent[6:] = opened, torch.where(INDEX, fist, opened)
    settings = replace(settings_of("contour_full"), learned_posture=False)
    tracker = Tracker(right_hand(), placed.camera, settings, shape=placed.shape)
    state, _ = run(tracker, [replace(placed, pose=straight).picture(seed=0)])
    picture = replace(placed, pose=straight).picture(seed=1)
    own = HandPose(dofs=bent, reference=placed.root_reference).normalized()
    return replace(placed, pose=straight), tracker, state, picture, own


def test_a_finger_that_is_left_out_of_the_silhouette_is_proposed_straight(stretched: Any) -> None:
    """The bent one that was followed covers nothing of it."""
    placed, tracker, state, picture, own = stretched
    scene = tracker.scene(state, [View(image=picture)], 1.0)
    best = _followed(tracker, scene, own, placed.shape)
    with torch.inference_mode():
        misplaced = _source(tracker).misplaced(best, scene, placed.shape)
        assert misplaced[:5] == NO_DIGIT
        assert misplaced[6]
        proposals = _source(tracker)(scene, state, best)
    bends = HandPose.stack([one.pose for one in proposals.hands]).dofs[:, 6:][:, INDEX].sum(-1)
    true = placed.pose[6:][INDEX].sum()
    assert float((own.dofs[6:][INDEX].sum() - true).abs()) > math.radians(150)
    assert float((bends - true).abs().min()) < math.radians(60)


def test_what_a_hand_leaves_out_counts_against_it(stretched: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    _, tracker, state, picture, own = stretched
    found = []
    for nats in (0.0, 4.5):
        monkeypatch.setattr("torchhand.track.alternatives._LEFT_OUT_NATS", nats)
        second = FurtherPass(tracker, replace(state, frames_since_refit=5)).step([View(image=picture)], 1.0, own.vector)
        assert second.evidence_before is not None
        found.append(second.evidence_before)
    assert found[0] - found[1] == pytest.approx(4.5)


def test_hands_are_weighed_by_digits_outside_as_well(folded: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Among those that are registered on a picture; the straight finger stays where nothing is solved."""
    placed, tracker, state, picture, true = folded
    scene = tracker.scene(state, [View(image=picture)], 1.0)
    straight = HandPose(dofs=placed.pose, reference=placed.root_reference)
    hands = HandPose.stack([true.normalized(), straight.normalized()])
    with torch.inference_mode():
        assert misplaced_nats(tracker, scene, hands, placed.shape).tolist() == [0.0, 4.5]
        assert misplaced_nats(tracker, scene, hands[:0], placed.shape).shape == (0,)
        beside = replace(scene, probabilities=(None,), masks=(None,))
        assert misplaced_nats(tracker, beside, hands, placed.shape).tolist() == [0.0, 0.0]
        costs = []
        for nats in (0.0, 1e6):
            monkeypatch.setattr("torchhand.track.alternatives._OUTSIDE_NATS", nats)
            found = TiltAlternatives(tracker, state)(scene, [true.normalized(), straight.normalized()])
            assert found is not None
            costs.append(found.cost.max())
    assert costs[1] - costs[0] > 1e5


def test_nothing_is_left_out_by_a_hand_in_its_place_nor_where_its_palm_is_seen_edge_on(stretched: Any) -> None:
    placed, tracker, state, picture, own = stretched
    scene = tracker.scene(state, [View(image=picture)], 1.0)
    plane = scene.plane(0)
    assert plane is not None
    edge = rotation_from_vector(torch.tensor((math.pi / 2, 0.0, 0.0)).double())
    true = HandPose(dofs=placed.pose, reference=placed.root_reference).normalized()
    turned = HandPose(dofs=own.dofs, reference=edge @ own.reference)
    behind = replace(own, dofs=torch.cat((own.dofs[:2], -own.dofs[2:3], own.dofs[3:])))

    def digits(*hands: HandPose, mask: torch.Tensor = plane > 0.5) -> PlacedDigits:
        return PlacedDigits(tracker.kinematics, placed.camera, HandPose.stack(hands), placed.shape, mask)

    assert digits(own, true, turned).leave_out().tolist() == [True, False, False]
    assert digits(own).near_left_out().any()
    assert not digits(true).near_left_out().any()
    assert not digits(own, mask=torch.zeros_like(plane, dtype=torch.bool)).leave_out().any()
    assert not digits(behind, own).leave_out().any()


@pytest.mark.parametrize(("before", "towards"), [("open", "fist"), ("fist", "open")])
def test_digits_are_moved_each_by_itself_and_all_together(before: str, towards: str) -> None:
    pose = HandPose(dofs=posture(before, dtype=torch.float64), reference=torch.eye(3, dtype=torch.float64))
    other = posture(towards, dtype=torch.float64)
    assert moved_digits(pose, torch.zeros(5, dtype=torch.bool), towards) is None
    moved = moved_digits(pose, torch.tensor((False, True, False, True, False)), towards)
    assert moved is not None
    assert moved.dofs.shape == (6, 36)
    assert moved.reference.shape == (6, 3, 3)
    is_moved = (moved.dofs != pose.dofs)[:, 6:].unflatten(1, (5, 6)).any(-1)
    alone, beside, both = (
        [False, True, False, False, False],
        [False, False, False, True, False],
        [False, True, False, True, False],
    )
    assert is_moved.tolist() == [alone, alone, beside, beside, both, both]
    torch.testing.assert_close(moved.dofs[1, 12:18], other[12:18])
    torch.testing.assert_close(moved.dofs[0, 12:18], 0.5 * (other + pose.dofs)[12:18])


def test_fingers_are_exchanged_with_those_that_lie_in_their_places() -> None:
    bends = {
        f"{finger}_{joint}_fe": 0.1 * number + place
        for number, finger in enumerate(FINGERS[1:], 1)
        for place, joint in enumerate(("mcp", "pip", "dip"))
    }
    joints = torch.tensor([bends.get(name, 0.3) for name in JOINT_DOFS], dtype=torch.float64)
    opened = posture("open", dtype=torch.float64)[6:]
    for found, places in zip(exchanged_fingers(joints), ("3210", "4321"), strict=True):
        told = dict(zip(JOINT_DOFS, found.tolist(), strict=True))
        usual = dict(zip(JOINT_DOFS, opened.tolist(), strict=True))
        for finger, place in zip(FINGERS[1:], map(int, places), strict=True):
            for joint in ("mcp", "pip", "dip"):
                name = f"{finger}_{joint}_fe"
                assert told.pop(name) == (bends[f"{FINGERS[place]}_{joint}_fe"] if place else usual[name])
        assert all(value == usual[name] for name, value in told.items())


@pytest.fixture(scope="module")
def turned_over(studio: Any) -> tuple[Tracker, TrackerState, View, HandPose, Proposed]:
    """A tracker and its state of a hand that was open; a picture in which it points with the index alone, that hand,
    and one from the other side in its place that shows about the same."""
    placed = studio.placed(size=0.7, view="palm", camera=studio.camera(320, 240))
    opened, fist, victory = (posture(name, dtype=torch.float64)[6:] for name in ("open", "fist", "victory"))
    middle = torch.tensor([name.startswith("middle") for name in JOINT_DOFS])
    straight, bent = placed.pose.clone(), placed.pose.clone()
    straight[6:], bent[6:] = opened, torch.where(middle, fist, victory)
    settings = replace(settings_of("contour_full"), learned_posture=False)
    tracker = Tracker(right_hand(), placed.camera, settings, shape=placed.shape)
    state, _ = run(tracker, [replace(placed, pose=straight).picture(seed=0)])
    view = View(image=replace(placed, pose=bent).picture(seed=1))
    true = HandPose(dofs=bent, reference=placed.root_reference).normalized()
    scene = tracker.scene(state, [view], 1 / 30)
    follows = _followed(tracker, scene, true, placed.shape)
    with torch.inference_mode():
        over = _source(tracker).turned_back(scene, placed.shape, replace(follows, pose=true)).hands[0]
    return tracker, state, view, true, over


def test_the_other_side_of_a_hand_shows_about_the_same(turned_over: Any) -> None:
    """And so does the other side of that: the hand itself."""
    tracker, state, view, true, over = turned_over
    assert _turned_deg(over.pose.rotation, true.rotation) > 120
    scene = tracker.scene(state, [view], 1 / 30)
    turned = tracker.candidate(over.pose, scene, state.shape)
    assert turned is not None
    assert turned.overlap > 0.8
    with torch.inference_mode():
        back = _source(tracker).turned_back(scene, state.shape, turned).hands
    found = [tracker.candidate(one.pose, scene, state.shape) for one in back]
    near = [one for one in found if one is not None and _turned_deg(one.rotation, true.rotation) < 30]
    assert max(one.overlap for one in near) > turned.overlap - 0.05


@pytest.mark.parametrize("began_open", [True, False])
def test_a_hand_whose_side_is_known_is_not_turned_over_where_that_side_shows_as_much(
    began_open: bool, turned_over: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Followed in a posture that explains little, it is found anew in the right one, and turned over where its side is
    only a guess."""
    tracker, state, view, true, over = turned_over
    opened = posture("open", dtype=torch.float64)[6:]
    poor = HandPose(dofs=torch.cat((true.dofs[:6], opened)), reference=true.reference)
    posed = posture("open" if began_open else "fist", dtype=torch.float64)
    state = replace(state, posture=posed, hand=tracker.parts.motion.started(poor))

    class Over:
        occasion = "always"

        def __call__(self, *_: Any) -> Proposals:
            return Proposals(hands=(over,), has_foreground=True)

    own = replace(tracker.parts, sources=(Over(), replace(_source(tracker), kinematics=tracker.kinematics)))
    monkeypatch.setattr(tracker, "parts", own)
    _, estimate = tracker.step(state, [view], 1 / 30, occasions=("always",))
    assert estimate.pose is not None
    away = _turned_deg(HandPose.of(estimate.pose).normalized().rotation, true.rotation)
    assert (away < 40) is began_open


def test_what_lies_outside_the_picture_is_not_outside_the_silhouette() -> None:
    mask = torch.zeros(40, 60, dtype=torch.bool)
    mask[10:20, 10:30] = True
    points = torch.full((21, 2), 15.0)
    points[5:9] = torch.tensor((-5.0, 15.0))  # the index beyond the border
    points[9:13] = torch.tensor((50.0, 30.0))  # the middle finger beside the hand
    points[13:17] = torch.nan
    assert outside(points, mask).tolist() == [0.0, 0.0, 1.0, 0.0, 0.0]


def test_what_the_network_said_before_counts_for_a_hand_and_for_its_alternatives(half_closed: Any) -> None:
    tracker, state, scene, _, tilted = half_closed
    followed = replace(_followed(tracker, scene, tilted, state.shape), direction=0.1)
    kept = followed.remembering(0.3)
    assert kept.direction == pytest.approx(0.8 * 0.3 + 0.2 * 0.1)
    assert kept.hand.direction == kept.direction
    assert followed.remembering(None).direction == 0.1
    assert replace(followed, direction=None).remembering(0.3).direction is None
    turns = [rotation_from_vector(torch.tensor((0.0, math.radians(deg), 0.0)).double()) for deg in (80.0, 100.0)]
    assert [followed.is_turned_from(turn @ followed.rotation) for turn in turns] == [False, True]


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


def test_a_proposed_hand_shares_what_the_network_said_before(half_closed: Any) -> None:
    """Of the followed one, which would else live on it."""
    tracker, state, scene, _, _ = half_closed
    image = scene.views[0].image
    assert state.hand is not None
    assert image is not None
    found = []
    for before in (None, 0.0):
        own = replace(state, time_s=0.0, hand=replace(state.hand, direction=before))
        after, estimate = tracker.step(own, [View(image=image)], 0.04)
        assert estimate.is_new
        found.append(after.hand.direction)
    assert found[0] > 0
    assert found[1] == pytest.approx(0.2 * found[0], rel=1e-6)
