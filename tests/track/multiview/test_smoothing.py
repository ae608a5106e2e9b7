"""What a hand that was found anew says about the frames before."""

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import max_pool2d

from torchhand.fit.hull import HullStartSettings
from torchhand.hand import HandPose, posture
from torchhand.track import DEFAULTS, HandKeypoints, Keyframe, PastFrame, Smoother, Tracker, TrackerState, View
from torchhand.track.multiview import HULL, RigSettings
from torchhand.track.scene import Scene

START = HullStartSettings(places=1, rolls=4, postures=("open",), coarse=6, fine=2, finger_rounds=0)
SETTINGS = replace(DEFAULTS["hull"], rig=RigSettings(start=START))
FRAMES = 5
STEP_S = 0.1
WINDOW_S = 1.0


@pytest.fixture(scope="module")
def tracker(rig_hand, rig):
    return Tracker(rig_hand, rig, SETTINGS)


@pytest.fixture(scope="module")
def poses(pose_at):
    return [pose_at(turn=0.3 + 0.02 * i, place=(0.003 * i, 0.08 - 0.002 * i, 0.001 * i)) for i in range(FRAMES)]


@pytest.fixture(scope="module")
def masks(poses, masks_of):
    return [masks_of(pose) for pose in poses]


def _views(masks):
    return tuple(View(mask=mask) for mask in masks)


def _past(masks, frame, keypoints, score, pose=None):
    masks = tuple(masks)
    scene = Scene(views=_views(masks), masks=masks, probabilities=(None,) * len(masks), time_s=round(frame * STEP_S, 9))
    return PastFrame.of(scene, keypoints, score, pose)


def _found(tracker, masks, frame, pose):
    """State and estimate of a frame in which the hand was found at some pose."""
    at = HandPose(dofs=pose[0], reference=pose[1]).normalized()
    known = Keyframe(time_s=round(frame * STEP_S, 9), pose=at)
    state = TrackerState(shape=tracker.kinematics.default_shape, keyframes=(known,))
    return tracker.step(state, _views(masks[frame]), round(frame * STEP_S, 9))


def _points(rig_hand, pose):
    return rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints


def _with_thumb_folded(pose):
    folded, names = pose[0].clone(), slice(6, 12)
    folded[names] = posture("fist", dtype=torch.float64)[names]
    return folded, pose[1]


def _seen(rig_hand, masks, poses, wrong):
    """The frames before the last as a tracker that lost the thumb in some of them would have left them."""
    return [
        _past(
            masks[frame],
            frame,
            _points(rig_hand, _with_thumb_folded(pose) if frame in wrong else pose),
            0.88 if frame in wrong else 0.96,
        )
        for frame, pose in enumerate(poses[:-1])
    ]


def _frames(estimates):
    return [round(estimate.time_s / STEP_S) for estimate in estimates]


def _corrected(tracker, masks, seen, pose, window_s=WINDOW_S):
    smoother = Smoother(tracker, window_s)
    for one in seen:
        smoother.remember(one)
    found = _found(tracker, masks, FRAMES - 1, pose)
    return smoother.corrections(*found), smoother, found


def test_a_frame_is_estimated_again_in_the_hull_that_was_carved_for_it(tracker, poses, masks):
    state, estimate = _found(tracker, masks, 2, poses[2])
    past = PastFrame.of(tracker.scene(state, _views(masks[2]), 2 * STEP_S), estimate.keypoints, estimate.score)
    scenes = [one.scene(tracker.device) for one in (past, replace(past, hull=None))]
    assert past.hull is not None
    assert scenes[0].kept[HULL] is past.hull
    hand = tracker.at_rest(state.hand)
    again, anew = (tracker.follow(state, hand, scene, STEP_S).estimate.keypoints for scene in scenes)
    assert scenes[0].kept[HULL] is past.hull
    assert float((again - anew).norm(dim=-1).max()) < 2e-4


def test_frames_with_a_lost_digit_are_corrected_and_those_before_stay(tracker, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong={2, 3})
    better, smoother, found = _corrected(tracker, masks, seen, poses[-1])
    assert _frames(better) == [3, 2]
    for frame, new in zip((3, 2), better, strict=True):
        assert float((new.keypoints - _points(rig_hand, poses[frame])).norm(dim=-1).mean()) < 0.004
        assert new.status == "tracked"
        assert new.score > seen[frame].score
        assert new.evidence is not None  # of the fingers: told of the frames that are corrected alone
        assert bool((torch.linalg.eigvalsh(new.keypoints_cov) > 0).all())
    assert smoother.corrections(*found) == []  # what was corrected is remembered so


def _known(rig_hand, masks, poses, wrong, score=0.93):
    """The frames before the last as they were followed, the thumb folded in one of them, which explains so much."""
    hands = [_with_thumb_folded(pose) if frame == wrong else pose for frame, pose in enumerate(poses[:-1])]
    return [
        _past(
            masks[frame], frame, _points(rig_hand, hand), score if frame == wrong else 0.96, HandPose.of(*hand).vector
        )
        for frame, hand in enumerate(hands)
    ]


def _followed(tracker, masks, poses):
    """State and estimate of the last frame, whose hand was followed there from the frame before."""
    state, _ = _found(tracker, masks, FRAMES - 2, poses[-2])
    state, estimate = tracker.step(state, _views(masks[FRAMES - 1]), round((FRAMES - 1) * STEP_S, 9))
    assert not estimate.is_new
    return state, estimate


@pytest.mark.parametrize(("wrong", "corrected"), [(3, [3]), (2, []), (None, [])])
def test_last_hand_that_left_its_path_is_begun_on_it(wrong, corrected, tracker, rig_hand, poses, masks):
    smoother = Smoother(tracker, WINDOW_S)
    for one in _known(rig_hand, masks, poses, wrong):
        smoother.remember(one)
    found = _followed(tracker, masks, poses)
    better = smoother.corrections(*found)
    assert _frames(better) == corrected
    for new in better:
        assert float((new.keypoints - _points(rig_hand, poses[3])).norm(dim=-1).max()) < 0.01
        assert new.evidence is not None
    assert smoother.corrections(*found) == []  # what was corrected is remembered so


def _grown(masks, pixels):
    return [max_pool2d(mask[None].double(), 2 * pixels + 1, 1, pixels)[0] > 0 for mask in masks]


def test_hand_that_explains_more_off_its_path_stays(tracker, rig_hand, poses, masks):
    masks = [*masks[:3], _grown(masks[3], 4), masks[4]]
    smoother = Smoother(tracker, WINDOW_S)
    for one in _known(rig_hand, masks, poses, wrong=3, score=0.96):
        smoother.remember(one)
    state, estimate = _found(tracker, masks, FRAMES - 1, poses[-1])
    assert smoother.corrections(state, replace(estimate, is_new=False)) == []


def test_hand_that_truly_left_its_path_stays(tracker, rig_hand, poses, masks, masks_of):
    folded = _with_thumb_folded(poses[3])
    masks = [*masks[:3], masks_of(folded), masks[4]]
    smoother = Smoother(tracker, WINDOW_S)
    for one in _known(rig_hand, masks, poses, wrong=3):
        smoother.remember(one)
    state, estimate = _found(tracker, masks, FRAMES - 1, poses[-1])
    assert smoother.corrections(state, replace(estimate, is_new=False)) == []


def _detected(past, rig, keypoints, count):
    """The same frame, in so many of whose pictures a detector sees the hand."""
    views = [
        replace(view, keypoints=HandKeypoints(points_px=camera.project(keypoints), score=0.9)) if row < count else view
        for row, (view, camera) in enumerate(zip(past.views, rig, strict=True))
    ]
    return replace(past, views=tuple(views))


@pytest.mark.parametrize(("pictures", "corrected"), [(1, [3, 2]), (2, [])])
def test_what_two_detectors_told_of_a_frame_is_not_corrected(pictures, corrected, tracker, rig, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong={2, 3})
    pairs = zip(seen, poses[:-1], strict=True)
    seen = [_detected(past, rig, _points(rig_hand, pose), pictures) for past, pose in pairs]
    better, _, _ = _corrected(tracker, masks, seen, poses[-1])
    assert _frames(better) == corrected


@pytest.mark.parametrize("pictures", [0, 2])
def test_frame_in_which_the_hand_was_lost_is_filled_in(pictures, tracker, rig, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong=set())
    seen[3] = replace(seen[3], keypoints=None, score=0.0)
    seen[3] = _detected(seen[3], rig, _points(rig_hand, poses[3]), pictures)
    better, _, _ = _corrected(tracker, masks, seen, poses[-1])
    assert _frames(better) == [3]
    assert float((better[0].keypoints - _points(rig_hand, poses[3])).norm(dim=-1).mean()) < 0.004


@pytest.mark.parametrize(("grown_px", "filled"), [(1, [3]), (2, []), (4, [])])
def test_lost_frame_is_filled_in_only_where_a_hand_could_be_found(grown_px, filled, tracker, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong=set())
    seen[3] = _past(_grown(masks[3], grown_px), 3, None, 0.0)
    better, _, _ = _corrected(tracker, masks, seen, poses[-1])
    assert _frames(better) == filled


def test_hand_that_turned_at_once_is_not_carried_back(tracker, rig_hand, poses, masks, pose_at, masks_of):
    turned = pose_at(turn=1.6, place=tuple(poses[-1][0][:3].tolist()))
    seen = _seen(rig_hand, masks, poses, wrong=set())
    better, _, (_, estimate) = _corrected(tracker, [*masks[:-1], masks_of(turned)], seen, turned)
    assert estimate.is_new
    assert estimate.score > 0.9
    assert better == []


def test_hand_that_was_followed_says_nothing_new(tracker, poses, masks):
    state, first = _found(tracker, masks, 0, poses[0])
    assert first.is_new
    smoother = Smoother(tracker, WINDOW_S)
    smoother.remember(_past(masks[0], 0, first.keypoints, 0.5))
    state, second = tracker.step(state, _views(masks[1]), STEP_S)
    assert not second.is_new
    assert smoother.corrections(state, second) == []


def test_hand_that_leapt_is_followed_back(tracker, rig_hand, poses, masks):
    state, first = _found(tracker, masks, 0, poses[0])
    smoother = Smoother(tracker, WINDOW_S)
    beside = poses[0][0].clone()
    beside[0] += 0.03
    smoother.remember(_past(masks[0], 0, _points(rig_hand, (beside, poses[0][1])), 0.5))
    state, second = tracker.step(state, _views(masks[1]), STEP_S)
    assert not second.is_new
    better = smoother.corrections(state, second)
    assert _frames(better) == [0]
    assert float((better[0].keypoints - first.keypoints).norm(dim=-1).mean()) < 0.002


def test_frames_that_do_not_follow_each_other_are_left_alone(tracker, rig_hand, poses, masks):
    """A gap of two frames is bridged only where the hand can still be followed over it."""
    seen = _seen(rig_hand, masks, poses, wrong={2, 3})
    better, _, _ = _corrected(tracker, masks, [*seen[:2], seen[3]], poses[-1])
    assert _frames(better)[:1] == [3]
    assert 0 not in _frames(better)


@pytest.mark.parametrize(("window_s", "kept"), [(STEP_S, [3]), (0.0, [])])
def test_only_the_last_frames_are_kept(window_s, kept, tracker, rig_hand, poses, masks):
    seen = _seen(rig_hand, masks, poses, wrong={2, 3})
    better, _, _ = _corrected(tracker, masks, seen, poses[-1], window_s)
    assert _frames(better) == kept
