"""The tracker on silhouettes of several cameras, step by step."""

from dataclasses import replace

import pytest
import torch

from tests.steps import FRAME_S, saved_and_restored
from torchhand.fit.hull import HullStartSettings
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose, posture
from torchhand.track import DEFAULTS, Keyframe, Tracker, TrackerState, View
from torchhand.track.multiview import FrameFitter, RigSettings
from torchhand.track.scene import Agreement

START = HullStartSettings(places=1, rolls=4, postures=("open",), coarse=6, fine=2, finger_rounds=0)
SELDOM = replace(DEFAULTS["hull"], rig=RigSettings(start=START))
SETTINGS = replace(SELDOM, health=replace(SELDOM.health, search_every=1, search_at_most_every=1))


def _views(masks):
    return [View(mask=mask) for mask in masks]


def _state(tracker, keyframe, **changes):
    """Of a hand that is known, with a keyframe at time 0."""
    at = HandPose(dofs=keyframe[0], reference=keyframe[1]).normalized()
    known = Keyframe(time_s=0.0, pose=at)
    return TrackerState(shape=tracker.kinematics.default_shape, keyframes=(known,), **changes)


def _error_mm(hand, estimate, pose) -> float:
    truth = hand.kinematics(pose[0], root_reference=pose[1]).keypoints
    return 1e3 * float((estimate.keypoints - truth).norm(dim=-1).mean())


@pytest.fixture(scope="module")
def tracker(rig_hand, rig):
    return Tracker(rig_hand, rig, SETTINGS)


@pytest.fixture(scope="module")
def poses(pose_at):
    """Four frames of a hand that moves and turns."""
    return [pose_at(turn=0.3 + 0.02 * i, place=(0.003 * i, 0.08 - 0.002 * i, 0.001 * i)) for i in range(4)]


@pytest.fixture(scope="module")
def run(tracker, poses, masks_of):
    """States and estimates of the frames, begun at a pose that is some way off."""
    pose, reference = poses[0]
    off = pose.clone()
    off[:3] += torch.tensor((0.008, -0.006, 0.005))
    turned = rotation_from_vector(torch.tensor((0.1, 0.1, -0.1), dtype=torch.float64)) @ reference
    state, found = _state(tracker, (off, turned)), []
    for frame, pose in enumerate(poses):
        state, estimate = tracker.step(state, _views(masks_of(pose)), frame * FRAME_S)
        found.append((state, estimate))
    return found


def test_hand_is_followed_from_a_keyframe(run, rig_hand, poses):
    for (_, estimate), pose in zip(run, poses, strict=True):
        assert estimate.status == "tracked"
        assert estimate.overlap > 0.85
        assert _error_mm(rig_hand, estimate, pose) < 4.0


def test_estimate_is_consistent(run, rig, rig_hand):
    estimate = run[-1][1]
    torch.testing.assert_close(rig_hand.kinematics(estimate.pose).keypoints, estimate.keypoints)
    seen = torch.stack([camera.project(estimate.keypoints) for camera in rig])
    torch.testing.assert_close(estimate.keypoints_px, seen)
    assert estimate.views == 4
    assert estimate.inside is not None
    assert bool((estimate.pose_std >= 0).all())
    assert bool((torch.linalg.eigvalsh(estimate.keypoints_cov) > 0).all())


def test_moving_hand_gets_a_speed(run, tracker):
    hand, space = run[-1][0].hand, tracker.parts.motion.space
    column = space.free_names.index("root_tx")
    assert float(hand.belief.mean[space.size + column]) == pytest.approx(0.09, abs=0.05)


def test_frames_without_silhouettes_are_lost_and_the_hand_is_found_again(run, tracker, poses, masks_of):
    state, _ = run[-1]
    nothing = [torch.zeros_like(mask) for mask in masks_of(poses[0])]
    for is_kept in (True, True, False):
        state, estimate = tracker.step(state, _views(nothing), state.time_s + FRAME_S)
        assert estimate.status == "no_hand"
        assert estimate.pose is None
        assert (state.hand is not None) is is_kept
    _, estimate = tracker.step(state, _views(masks_of(poses[1])), state.time_s + FRAME_S)
    assert estimate.status == "recovered"
    assert estimate.overlap > 0.85


def test_a_lost_hand_is_not_found_where_it_cannot_be_yet(run, tracker, poses, masks_of):
    before, _ = run[-1]
    assert before.last_seen is not None
    assert before.last_seen.time_s == before.time_s
    pose = before.last_seen.pose
    far = replace(before.last_seen, pose=replace(pose, dofs=pose.dofs + 1.0 * (torch.arange(36) == 0)))
    lost, views = replace(before, hand=None, last_seen=far), _views(masks_of(poses[3]))
    _, estimate = tracker.step(lost, views, before.time_s + FRAME_S)
    assert estimate.status == "lost"
    assert estimate.reason == "what looks like a hand is 1.0 m from where it was 0.03 s before"
    _, estimate = tracker.step(lost, views, before.time_s + 0.5)
    assert estimate.status == "recovered"


def test_missing_view_is_done_without(run, tracker, rig_hand, poses, masks_of):
    state, _ = run[1]
    masks = masks_of(poses[2])
    masks[2] = None
    _, estimate = tracker.step(state, _views(masks), state.time_s + FRAME_S)
    assert estimate.status == "tracked"
    assert estimate.views == 3
    assert bool(estimate.overlaps[2].isnan())
    assert _error_mm(rig_hand, estimate, poses[2]) < 5.0


def test_view_that_shows_something_else_does_not_pull_the_hand_away(run, tracker, rig_hand, poses, masks_of):
    state, _ = run[1]
    masks = masks_of(poses[2])
    masks[3] = masks[3].roll((-60, 70), (0, 1))
    _, estimate = tracker.step(state, _views(masks), state.time_s + FRAME_S)
    assert estimate.status == "tracked"
    assert _error_mm(rig_hand, estimate, poses[2]) < 6.0


def test_hand_that_turns_and_changes_its_digits_at_once_is_followed(rig_hand, rig, pose_at, masks_of):
    tracker = Tracker(rig_hand, rig, SELDOM)
    before, after = pose_at("fist", turn=0.0), pose_at("shaka", turn=1.2)
    state, _ = tracker.step(_state(tracker, before, usual_score=0.92), _views(masks_of(before)), 0.0)
    state = replace(state, frames_since_search=0, search_after=10)  # no search without a guess is due
    _, estimate = tracker.step(state, _views(masks_of(after)), FRAME_S)
    assert estimate.status == "tracked"
    assert _error_mm(rig_hand, estimate, after) < 5.0


def test_digit_that_was_left_behind_is_fetched_now_and_then(tracker, rig_hand, pose_at, masks_of):
    right = pose_at("open")
    wrong = right[0].clone()
    little = slice(30, 36)
    wrong[little] = 0.4 * wrong[little] + 0.6 * posture("fist", dtype=torch.float64)[little]
    state, _ = tracker.step(_state(tracker, (wrong, right[1])), _views(masks_of((wrong, right[1]))), 0.0)
    state = replace(state, usual_score=0.9, best_score=0.98)  # as after some frames without that digit
    errors_mm = []
    for since in (0, 20):
        after, estimate = tracker.step(replace(state, frames_since_refit=since), _views(masks_of(right)), FRAME_S)
        errors_mm.append(_error_mm(rig_hand, estimate, right))
        assert estimate.is_new == (since > 0)
        assert after.frames_since_refit == (0 if since else 1)
    assert errors_mm[0] > 4.0
    assert errors_mm[1] < 1.5


def test_something_that_is_no_hand_is_not_tracked(tracker, rig):
    masks = []
    for camera in rig:
        y, x = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
        masks.append(((x - 120).abs() < 70) & ((y - 90).abs() < 60))
    state = TrackerState(shape=tracker.kinematics.default_shape)
    state, estimate = tracker.step(state, _views(masks), 0.0)
    assert state.hand is None
    assert estimate.status == "no_hand"
    assert "overlap" in estimate.reason


def test_saved_and_restored_goes_on_the_same(run, tracker, poses, masks_of):
    state, _ = run[1]
    again = saved_and_restored(state)
    torch.testing.assert_close(again.keyframes[0].pose.dofs, state.keyframes[0].pose.dofs)
    poses_found = [
        tracker.step(known, _views(masks_of(poses[2])), state.time_s + FRAME_S)[1].pose for known in (state, again)
    ]
    assert torch.equal(*poses_found)


def test_torques_follow_a_slow_hand(rig_hand, rig, run, poses, masks_of):
    settings = replace(SETTINGS, rig=replace(SETTINGS.rig, fitting="torque"))
    state, _ = run[1]
    _, estimate = Tracker(rig_hand, rig, settings).step(state, _views(masks_of(poses[2])), state.time_s + FRAME_S)
    assert estimate.status == "tracked"
    assert estimate.overlap is not None
    assert estimate.overlap > 0.75


@pytest.mark.parametrize("method", ["contour", "distance"])
def test_other_update_rules_follow_the_hand_in_all_views(method, rig_hand, rig, run, poses, masks_of):
    """One tracker, any rule, any number of cameras: the beginning is the hull's, the update the rule's own."""
    own = DEFAULTS[method]
    settings = replace(own, pose_space="dof26", rig=RigSettings(start=START))
    tracker = Tracker(rig_hand, rig, settings)
    state = _state(tracker, poses[0])
    for frame, pose in enumerate(poses[:3]):
        state, estimate = tracker.step(state, _views(masks_of(pose)), frame * FRAME_S)
        assert estimate.status == "tracked"
        assert estimate.views == 4
        assert _error_mm(rig_hand, estimate, pose) < 6.0
    assert not estimate.is_new


def test_one_camera_has_no_hull(rig_hand, rig):
    with pytest.raises(ValueError, match=r"method: expected contour or distance for one camera, got 'hull'"):
        Tracker(rig_hand, rig[0], SETTINGS)
    with pytest.raises(ValueError, match=r"cameras: expected at least one, got none"):
        Tracker(rig_hand, (), SETTINGS)


def test_other_hands_are_tried_seldom_for_one_that_stays_degraded(rig_hand, rig, poses, masks_of, monkeypatch):
    """Three views of a hand and one that shows half of it: its edges are never explained well."""
    tracker, asked = Tracker(rig_hand, rig, SELDOM), []
    masks = masks_of(poses[0])
    masks[0][:, : masks[0].nonzero()[:, 1].median()] = False
    state = _state(tracker, poses[0], usual_score=1.0)
    for name in ("fit_proposed", "vary_orientation", "vary_fingers", "search", "refine"):
        monkeypatch.setattr(FrameFitter, name, lambda *_, own=name, **__: asked.append(own))
    hand = tracker.parts.motion.started(HandPose(dofs=poses[0][0], reference=poses[0][1]).normalized())
    state = replace(state, hand=hand, keyframes=(), has_started=True)
    counts = []
    for frame in range(24):
        before = len(asked)
        state, estimate = tracker.step(replace(state, usual_score=1.0), _views(masks), frame * FRAME_S)
        assert estimate.status == "tracked"
        counts.append(len(asked) - before)
    assert counts[0] >= 3  # all at once when it has become so
    assert max(counts[1:]) <= 2  # one source after the other; what is seen is fitted as detected, then as proposed
    assert 2 <= sum(count > 0 for count in counts[1:]) <= 4


@pytest.mark.parametrize("score", [0.5, 0.99])
def test_refit_takes_large_steps_where_small_ones_explain_no_more(
    score, tracker, rig_hand, poses, masks_of, monkeypatch
):
    told, masks = [], masks_of(poses[0])
    refit = next(source for source in tracker.parts.sources if type(source).__name__ == "Refit")
    state, exact = _state(tracker, poses[0]), HandPose(dofs=poses[0][0], reference=poses[0][1]).normalized()
    scene = tracker.scene(state, _views(masks), 0.0)
    best = tracker.candidate(exact, scene, state.shape)
    best = replace(best, agreement=Agreement.of_overlaps(torch.full((4,), 0.7)), edges=0.7)

    def refine(fitter, hull, start, shape, masks, *, is_enough):
        fit = fitter.fit_from(hull, [start], shape, masks)
        told.append(is_enough(replace(fit, overlaps=torch.full((4,), score), covered_fraction=score)))
        return fit

    monkeypatch.setattr(FrameFitter, "refine", refine)
    with torch.inference_mode():
        refit(scene, state, best)
    assert told == [score > 0.7]


def test_other_hands_are_tried_seldom_while_the_hand_stays_lost(rig_hand, rig, poses, masks_of, monkeypatch):
    tracker, asked = Tracker(rig_hand, rig, SELDOM), []
    for name in ("fit_proposed", "vary_orientation", "vary_fingers", "search", "refine"):
        monkeypatch.setattr(FrameFitter, name, lambda *_, own=name, **__: asked.append(own))
    state = replace(_state(tracker, poses[0], usual_score=1.0), hand=None, keyframes=(), has_started=True)
    counts = []
    for frame in range(8):
        before = len(asked)
        state, estimate = tracker.step(state, _views(masks_of(poses[0])), frame * FRAME_S)
        assert estimate.pose is None
        counts.append(len(asked) - before)
    assert counts[0] >= 1
    assert sum(count > 0 for count in counts) <= 5


def test_a_hand_that_leaves_one_of_two_pictures_is_followed_in_the_other(rig_hand, rig, pose_at, masks_of):
    width = 130
    front, side = rig[0], replace(rig[1], width=width)
    places = [(0.0, 0.08, -0.06 + 0.008 * frame) for frame in range(24)]
    course = [pose_at(turn=0.3, place=place) for place in places]
    tracker = Tracker(rig_hand, [front, side], SELDOM)
    state, shown, errors = _state(tracker, course[0]), [], []
    for frame, pose in enumerate(course):
        masks = masks_of(pose)
        views = _views([masks[0], masks[1][:, :width]])
        state, estimate = tracker.step(state, views, frame * FRAME_S)
        points = side.project(rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints)
        shown.append(float((points[:, 0] < width).double().mean()))
        assert estimate.status == "tracked"
        errors.append(_error_mm(rig_hand, estimate, pose))
    assert shown[0] == 1.0
    assert shown[-1] == 0.0
    assert estimate.overlaps is not None
    assert estimate.overlaps.isfinite().tolist() == [True, False]
    assert max(errors) < 5.0
