"""Proportions that a tracker finds while it follows a hand of which it knows none."""

from dataclasses import replace
from functools import partial

import pytest
import torch

from tests.steps import FRAME_S, saved_and_restored
from torchhand.fit.hull import HullShapeSettings
from torchhand.track import DEFAULTS, Tracker, View
from torchhand.view import mesh_silhouette

POSTURES = ("open", "point", "victory")
SETTINGS = replace(
    DEFAULTS["hull"], rig=replace(DEFAULTS["hull"].rig, shape_frames=3, shape=HullShapeSettings(rounds=4))
)


@pytest.fixture(scope="module")
def large(rig_hand):
    """A hand a tenth larger than the generic one."""
    space = rig_hand.kinematics.shape_space
    metric = torch.tensor([unit == "m" for unit in space.units])
    shape = rig_hand.kinematics.default_shape
    return torch.where(metric, 1.1 * shape, shape).clamp(space.lower.to(shape), space.upper.to(shape))


@pytest.fixture(scope="module")
def scenes(large, rig_hand, rig, pose_at):
    """Three postures of it, each in two frames."""
    found = []
    for name in POSTURES:
        pose, reference = pose_at(name)
        state = rig_hand(pose, large, root_reference=reference)
        masks = [mesh_silhouette(state.vertices, rig_hand.faces, camera) for camera in rig]
        found += [[View(mask=mask) for mask in masks]] * 2
    return found


@pytest.fixture(scope="module")
def run(rig_hand, rig, scenes):
    tracker, state, found = Tracker(rig_hand, rig, SETTINGS), None, []
    for frame, views in enumerate(scenes):
        state, estimate = tracker.step(state, views, frame * FRAME_S)
        found.append((state, estimate))
    return found


def _length(rig_hand, shape) -> float:
    return float(rig_hand.kinematics.shape_space.metric(shape)["hand_length"])


def test_size_is_found_in_the_first_frames(run, rig_hand, large):
    true, generic = _length(rig_hand, large), _length(rig_hand, rig_hand.kinematics.default_shape)
    assert all(estimate.status == "tracked" for _, estimate in run)
    found = [_length(rig_hand, state.shape) for state, _ in run]
    assert abs(found[0] - true) < 0.5 * abs(generic - true)
    assert abs(found[-1] - true) < 0.2 * abs(generic - true)


def test_frames_are_kept_that_show_the_hand_otherwise_until_there_are_enough(run):
    kept = [None if state.shape_frames is None else len(state.shape_frames) for state, _ in run]
    assert kept == [1, 1, 2, 2, None, None]
    assert torch.equal(run[-1][0].shape, run[-2][0].shape)


def test_saved_and_restored_it_goes_on_the_same(run, rig_hand, rig, scenes):
    tracker = Tracker(rig_hand, rig, SETTINGS)
    state, _ = tracker.step(saved_and_restored(run[3][0]), scenes[4], 4 * FRAME_S)
    assert state.shape is not None
    assert torch.equal(state.shape, run[4][0].shape)


def test_a_step_that_must_be_quick_keeps_frames_for_a_fit_that_is_the_same(run, rig_hand, rig, scenes):
    tracker = Tracker(rig_hand, rig, SETTINGS)
    step = partial(tracker.step, occasions=("always", "detected", "declining", "degraded"))
    quick, _ = step(run[3][0], scenes[4], 4 * FRAME_S)
    further, _ = step(quick, scenes[0], 5 * FRAME_S)
    kept = [[] if one.shape_frames is None else one.shape_frames for one in (run[3][0], quick, further)]
    assert [len(frames) for frames in kept] == [2, 3, 3]  # no more than are wanted
    assert quick.shape is not None
    assert torch.equal(quick.shape, run[3][0].shape)
    assert tracker.is_reshape_due(quick)
    fitted = tracker.reshaped(quick)
    assert fitted.shape_frames is None
    assert not tracker.is_reshape_due(fitted)
    assert fitted.shape is not None
    assert torch.equal(fitted.shape, run[4][0].shape)


def test_known_proportions_stay(rig_hand, rig, large):
    tracker = Tracker(rig_hand, rig, SETTINGS, shape=large)
    empty = [View(mask=torch.zeros(camera.height, camera.width, dtype=torch.bool)) for camera in rig]
    state, _ = tracker.step(None, empty, 0.0)
    assert state.shape_frames is None
    assert state.shape is not None
    assert torch.equal(state.shape, large)
