from dataclasses import replace

import pytest
import torch

from torchhand.fit.hull import HullStartSettings
from torchhand.geometry import rotation_from_vector
from torchhand.hand import posture
from torchhand.track.multiview.fitting import Anchor
from torchhand.track.multiview.saved import Knowledge, restored, saved
from torchhand.track.multiview.settings import MultiViewLossSettings, RigSettings
from torchhand.track.multiview.tracker import MultiViewMemory, MultiViewTracker

SETTINGS = RigSettings(
    start=HullStartSettings(places=1, rolls=4, postures=("open",), coarse=6, fine=2, finger_rounds=0),
    loss=MultiViewLossSettings(search_every=1, search_seldom=1),
)


@pytest.fixture(scope="module")
def tracker(rig_hand, rig):
    return MultiViewTracker(rig_hand, rig, 30.0, SETTINGS)


@pytest.fixture(scope="module")
def poses(pose_at):
    """Four frames of a hand that moves and turns."""
    return [pose_at(turn=0.3 + 0.02 * i, place=(0.003 * i, 0.08 - 0.002 * i, 0.001 * i)) for i in range(4)]


@pytest.fixture(scope="module")
def run(tracker, rig_hand, poses, masks_of):
    """States, memories and estimates of the frames, begun at a pose that is some way off."""
    with torch.inference_mode():
        pose, reference = poses[0]
        off = pose.clone()
        off[:3] += torch.tensor((0.008, -0.006, 0.005))
        turned = rotation_from_vector(torch.tensor((0.1, 0.1, -0.1), dtype=torch.float64)) @ reference
        anchors = {0: Anchor(pose=off, root_reference=turned)}
        state, memory = None, MultiViewMemory(shape=rig_hand.kinematics.default_shape)
        found = []
        for moment, pose in enumerate(poses):
            state, memory, estimate = tracker.step(state, memory, masks_of(pose), anchors, moment)
            found.append((state, memory, estimate))
    return found


def _error_mm(rig_hand, estimate, pose) -> float:
    truth = rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints
    return 1e3 * float((estimate.keypoints - truth).norm(dim=-1).mean())


def test_hand_is_followed_from_an_anchor(run, rig_hand, poses):
    for (_, _, estimate), pose in zip(run, poses, strict=True):
        assert estimate.status == "tracked"
        assert estimate.overlap > 0.85
        assert _error_mm(rig_hand, estimate, pose) < 4.0


def test_estimate_is_consistent(run, rig_hand):
    estimate = run[-1][2]
    again = rig_hand.kinematics(estimate.pose).keypoints
    torch.testing.assert_close(again, estimate.keypoints)
    assert estimate.views == 4
    assert bool((estimate.pose_std >= 0).all())
    assert bool((torch.linalg.eigvalsh(estimate.keypoints_cov) > 0).all())


def test_moving_hand_gets_a_speed(run, tracker):
    state = run[-1][0]
    column = tracker.space.free_names.index("root_tx")
    assert float(state.belief.mean[tracker.space.size + column]) == pytest.approx(0.09, abs=0.05)


def test_frames_without_silhouettes_are_lost_and_the_hand_is_found_again(run, tracker, poses, masks_of):
    state, memory, _ = run[-1]
    with torch.inference_mode():
        nothing = [torch.zeros_like(mask) for mask in masks_of(poses[0])]
        for expected in (True, True, False):
            state, memory, estimate = tracker.step(state, memory, nothing)
            assert estimate.status == "no_hand"
            assert estimate.pose is None
            assert (state is not None) is expected
        _, memory, estimate = tracker.step(state, memory, masks_of(poses[1]))
    assert estimate.status == "recovered"
    assert estimate.overlap > 0.85


def test_missing_view_is_done_without(run, tracker, rig_hand, poses, masks_of):
    state, memory, _ = run[1]
    masks = masks_of(poses[2])
    masks[2] = None
    with torch.inference_mode():
        _, _, estimate = tracker.step(state, memory, masks)
    assert estimate.status == "tracked"
    assert estimate.views == 3
    assert bool(estimate.overlaps[2].isnan())
    assert _error_mm(rig_hand, estimate, poses[2]) < 5.0


def test_view_that_shows_something_else_does_not_pull_the_hand_away(run, tracker, rig_hand, poses, masks_of):
    state, memory, _ = run[1]
    masks = masks_of(poses[2])
    masks[3] = masks[3].roll((-60, 70), (0, 1))
    with torch.inference_mode():
        _, _, estimate = tracker.step(state, memory, masks)
    assert estimate.status == "tracked"
    assert _error_mm(rig_hand, estimate, poses[2]) < 6.0


def test_hand_that_turns_and_changes_its_digits_at_once_is_followed(rig_hand, rig, pose_at, masks_of):
    tracker = MultiViewTracker(rig_hand, rig, 30.0, replace(SETTINGS, loss=MultiViewLossSettings()))
    memory = MultiViewMemory(shape=rig_hand.kinematics.default_shape, score=0.92)
    before, after = pose_at("fist", turn=0.0), pose_at("shaka", turn=1.2)
    with torch.inference_mode():
        anchors = {0: Anchor(pose=before[0], root_reference=before[1])}
        state, memory, _ = tracker.step(None, memory, masks_of(before), anchors, 0)
        memory = replace(memory, frames_since_search=0, search_after=10)  # no search without a guess is due
        _, _, estimate = tracker.step(state, memory, masks_of(after), {}, 1)
    assert estimate.status == "tracked"
    assert _error_mm(rig_hand, estimate, after) < 5.0


def test_digit_that_was_left_behind_is_fetched_now_and_then(tracker, rig_hand, pose_at, masks_of):
    right = pose_at("open")
    astray = right[0].clone()
    little = slice(30, 36)
    astray[little] = 0.4 * astray[little] + 0.6 * posture("fist", dtype=torch.float64)[little]
    memory = MultiViewMemory(shape=rig_hand.kinematics.default_shape)
    errors_mm = []
    with torch.inference_mode():
        anchors = {0: Anchor(pose=astray, root_reference=right[1])}
        state, memory, _ = tracker.step(None, memory, masks_of((astray, right[1])), anchors, 0)
        memory = replace(memory, score=0.9, best_score=0.98)  # as after some frames without that digit
        for since in (0, 20):
            memory = replace(memory, frames_since_settled=since)
            _, after, estimate = tracker.step(state, memory, masks_of(right), {}, 1)
            errors_mm.append(_error_mm(rig_hand, estimate, right))
            assert estimate.is_new == (since > 0)
            assert after.frames_since_settled == (0 if since else 1)
    assert errors_mm[0] > 4.0
    assert errors_mm[1] < 1.5


def test_something_that_is_no_hand_is_not_tracked(tracker, rig_hand, rig):
    masks = []
    for camera in rig:
        y, x = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
        masks.append(((x - 120).abs() < 70) & ((y - 90).abs() < 60))
    memory = MultiViewMemory(shape=rig_hand.kinematics.default_shape)
    with torch.inference_mode():
        state, _, estimate = tracker.step(None, memory, masks)
    assert state is None
    assert estimate.status == "no_hand"
    assert "overlap" in estimate.reason


def test_saved_and_restored_goes_on_the_same(run, tracker, poses, masks_of, tmp_path):
    state, memory, _ = run[1]
    knowledge = Knowledge(state=state, memory=memory, skins=[None, None], anchors={5: _anchor(poses[0])}, metres=0.04)
    torch.save(saved(knowledge), tmp_path / "state.pt")
    again = restored(torch.load(tmp_path / "state.pt", weights_only=True))
    assert again.metres == 0.04
    torch.testing.assert_close(again.anchors[5].pose, poses[0][0])
    with torch.inference_mode():
        results = [tracker.step(known.state, known.memory, masks_of(poses[2]))[2].pose for known in (knowledge, again)]
    assert torch.equal(*results)


def test_torques_follow_a_slow_hand(rig_hand, rig, run, poses, masks_of):
    tracker = MultiViewTracker(rig_hand, rig, 30.0, replace(SETTINGS, fitting="torque"))
    state, memory, _ = run[1]
    with torch.inference_mode():
        _, _, estimate = tracker.step(state, memory, masks_of(poses[2]))
    assert estimate.status == "tracked"
    assert estimate.overlap is not None
    assert estimate.overlap > 0.75


def _anchor(pose) -> Anchor:
    return Anchor(pose=pose[0], root_reference=pose[1])


def test_frame_rate_is_checked(rig_hand, rig):
    with pytest.raises(ValueError, match="frames_per_second"):
        MultiViewTracker(rig_hand, rig, 0.0)
