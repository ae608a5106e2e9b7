"""What a hand that was found anew says about the moments before."""

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import max_pool2d

from torchhand.fit.hull import HullStartSettings
from torchhand.hand import posture
from torchhand.track.multiview.fitting import Anchor
from torchhand.track.multiview.hindsight import Hindsight, SeenMoment
from torchhand.track.multiview.settings import RigSettings
from torchhand.track.multiview.tracker import MultiViewMemory, MultiViewTracker

SETTINGS = RigSettings(
    start=HullStartSettings(places=1, rolls=4, postures=("open",), coarse=6, fine=2, finger_rounds=0)
)
MOMENTS = 5


@pytest.fixture(scope="module")
def tracker(rig_hand, rig):
    return MultiViewTracker(rig_hand, rig, 10.0, SETTINGS)


@pytest.fixture(scope="module")
def poses(pose_at):
    return [pose_at(turn=0.3 + 0.02 * i, place=(0.003 * i, 0.08 - 0.002 * i, 0.001 * i)) for i in range(MOMENTS)]


@pytest.fixture(scope="module")
def masks(poses, masks_of):
    return [masks_of(pose) for pose in poses]


def _found(tracker, rig_hand, masks, moment, pose):
    """State, memory and estimate of a moment in which the hand was found at some pose."""
    memory = MultiViewMemory(shape=rig_hand.kinematics.default_shape)
    anchors = {moment: Anchor(pose=pose[0], root_reference=pose[1])}
    with torch.inference_mode():
        return tracker.step(None, memory, masks[moment], anchors, moment)


def _points(rig_hand, pose):
    return rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints


def _with_thumb_folded(pose):
    folded, names = pose[0].clone(), slice(6, 12)
    folded[names] = posture("fist", dtype=torch.float64)[names]
    return folded, pose[1]


def _seen(rig_hand, masks, poses, wrong):
    """The moments before the last as a tracker that lost the thumb in some of them would have left them."""
    return [
        SeenMoment.of(
            moment,
            masks[moment],
            _points(rig_hand, _with_thumb_folded(pose) if moment in wrong else pose),
            0.88 if moment in wrong else 0.96,
        )
        for moment, pose in enumerate(poses[:-1])
    ]


def _looked_back(tracker, rig_hand, masks, seen, pose):
    hindsight = Hindsight(tracker)
    for one in seen:
        hindsight.remember(one)
    with torch.inference_mode():
        found = _found(tracker, rig_hand, masks, MOMENTS - 1, pose)
        return hindsight.look_back(MOMENTS - 1, *found), hindsight, found


def test_moments_with_a_lost_digit_are_corrected_and_those_before_stay(tracker, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong={2, 3})
    better, hindsight, found = _looked_back(tracker, rig_hand, masks, seen, poses[-1])
    assert [old.moment for old, _ in better] == [3, 2]
    for old, new in better:
        assert old is seen[old.moment]
        error = (new.keypoints - _points(rig_hand, poses[old.moment])).norm(dim=-1)
        assert float(error.mean()) < 0.004
        assert new.status == "tracked"
        assert new.score > old.score
        assert bool((torch.linalg.eigvalsh(new.keypoints_cov) > 0).all())
    with torch.inference_mode():  # what was corrected is remembered so
        assert hindsight.look_back(MOMENTS - 1, *found) == []


def test_moment_in_which_the_hand_was_lost_is_filled_in(tracker, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong=set())
    seen[3] = replace(seen[3], keypoints=None, score=0.0)
    better, _, _ = _looked_back(tracker, rig_hand, masks, seen, poses[-1])
    assert [old.moment for old, _ in better] == [3]
    assert float((better[0][1].keypoints - _points(rig_hand, poses[3])).norm(dim=-1).mean()) < 0.004


@pytest.mark.parametrize(("grown_px", "filled"), [(1, [3]), (2, []), (4, [])])
def test_lost_moment_is_filled_in_only_where_a_hand_could_be_found(grown_px, filled, tracker, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong=set())
    side = 2 * grown_px + 1
    grown = [max_pool2d(mask[None].double(), side, 1, grown_px)[0] > 0 for mask in masks[3]]
    seen[3] = SeenMoment.of(3, grown, None, 0.0)
    better, _, _ = _looked_back(tracker, rig_hand, masks, seen, poses[-1])
    assert [old.moment for old, _ in better] == filled


def test_hand_that_turned_at_once_is_not_carried_back(tracker, rig_hand, poses, masks, pose_at, masks_of):
    turned = pose_at(turn=1.6, place=tuple(poses[-1][0][:3].tolist()))
    seen = _seen(rig_hand, masks, poses, wrong=set())
    better, _, found = _looked_back(tracker, rig_hand, [*masks[:-1], masks_of(turned)], seen, turned)
    assert found[2].is_new
    assert found[2].score > 0.9
    assert better == []


def test_hand_that_was_followed_says_nothing_new(tracker, rig_hand, poses, masks):
    state, memory, first = _found(tracker, rig_hand, masks, 0, poses[0])
    assert first.is_new
    hindsight = Hindsight(tracker)
    hindsight.remember(SeenMoment.of(0, masks[0], first.keypoints, 0.5))
    with torch.inference_mode():
        state, memory, second = tracker.step(state, memory, masks[1], {}, 1)
        assert not second.is_new
        assert hindsight.look_back(1, state, memory, second) == []


def test_hand_that_leapt_is_followed_back(tracker, rig_hand, poses, masks):
    state, memory, first = _found(tracker, rig_hand, masks, 0, poses[0])
    hindsight = Hindsight(tracker)
    pose, reference = poses[0]
    beside = pose.clone()
    beside[0] += 0.03
    points = _points(rig_hand, (beside, reference))
    hindsight.remember(SeenMoment.of(0, masks[0], points, 0.5))
    with torch.inference_mode():
        state, memory, second = tracker.step(state, memory, masks[1], {}, 1)
        assert not second.is_new
        better = hindsight.look_back(1, state, memory, second)
    assert [old.moment for old, _ in better] == [0]
    assert float((better[0][1].keypoints - first.keypoints).norm(dim=-1).mean()) < 0.002


def test_moments_that_do_not_follow_each_other_are_left_alone(tracker, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong={2, 3})
    better, _, _ = _looked_back(tracker, rig_hand, masks, [*seen[:2], seen[3]], poses[-1])
    assert [old.moment for old, _ in better] == [3]


def test_only_the_last_moments_are_kept(rig_hand, rig, poses, masks):
    for seconds, kept in ((0.1, [3]), (0.0, [])):
        tracker = MultiViewTracker(rig_hand, rig, 10.0, replace(SETTINGS, look_back_s=seconds))
        seen = _seen(rig_hand, masks, poses, wrong={2, 3})
        better, _, _ = _looked_back(tracker, rig_hand, masks, seen, poses[-1])
        assert [old.moment for old, _ in better] == kept
