"""Scenes that are made, and fingers that are judged, in another process while a tracker is busy: the same results,
whatever comes in between."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import pytest
import torch

from torchhand.cluster import can_copy_process
from torchhand.devices import HOST
from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose
from torchhand.runs import settings_of
from torchhand.simulate import Staging, named_rig, scripted_motion, stage_camera
from torchhand.track import Estimate, Keyframe, ScenesAhead, Tracker, TrackerState, View
from torchhand.track.ahead import Frame
from torchhand.track.tracker import Foreseen
from torchhand.view import mesh_silhouette

FRAMES, FPS = 5, 30.0


@dataclass(frozen=True, kw_only=True)
class Case:
    """A hand before four cameras, and trackers of it that know where it begins."""

    make: partial[Tracker]
    start: TrackerState
    frames: list[Frame]


@pytest.fixture(scope="module")
def case() -> Case:
    hand = load_hand_model().hand(side="right", dtype=torch.float64)
    cameras, generator = named_rig("frame4", size=(160, 120)), torch.Generator().manual_seed(3)
    stage = stage_camera(cameras, float(hand.kinematics.shape_space.metric(hand.shape)["hand_length"]))
    course = scripted_motion("free", FRAMES, hand.kinematics, stage, generator, staging=Staging(fps=FPS))
    frames, turn = [], course.root_reference.double()
    for index, pose in enumerate(course.poses):
        vertices = hand(pose.double(), root_reference=turn).vertices
        views = [View(mask=mesh_silhouette(vertices, hand.faces, camera)) for camera in cameras]
        frames.append((views, index / FPS))
    dofs = course.poses[0].double().clone()
    reference = rotation_from_vector(dofs[3:6]) @ turn
    dofs[3:6] = 0
    keyframe = Keyframe(time_s=0.0, pose=HandPose(dofs=dofs, reference=reference))
    return Case(
        make=partial(Tracker, hand, cameras, settings_of("hull_lm"), shape=hand.shape),
        start=TrackerState(shape=hand.shape, keyframes=(keyframe,)),
        frames=frames,
    )


@pytest.fixture(scope="module")
def alone(case: Case) -> list[Estimate]:
    """Estimates by the tracker without another process."""
    tracker, state, found = case.make(), case.start, []
    for frame in case.frames:
        state, estimate = tracker.step(state, *frame)
        found.append(estimate)
    return found


@pytest.fixture(scope="module", params=[True, False], ids=["a copy", "a new process"])
def ahead(case: Case, request: pytest.FixtureRequest) -> Iterator[ScenesAhead]:
    with pytest.MonkeyPatch.context() as patch:
        if not request.param:
            patch.setattr("torchhand.track.ahead.can_copy_process", lambda device: False)
        elif not can_copy_process(HOST):
            pytest.skip("processes cannot be copied here")
        with ScenesAhead(case.make, case.make()) as ahead:
            ahead.wait()
            yield ahead


def _assert_same(found: Estimate, expected: Estimate) -> None:
    for name in ("pose", "keypoints", "keypoints_cov", "finger_quality", "evidence"):
        own, other = getattr(found, name), getattr(expected, name)
        assert own is not None, (name, found.reason)
        assert torch.equal(own, other), name
    assert found.quality == expected.quality


@pytest.mark.parametrize("is_behind", [True, False], ids=["judged here", "judged there"])
def test_results_are_those_of_the_tracker_alone_bit_for_bit(
    case: Case, alone: list[Estimate], ahead: ScenesAhead, monkeypatch: pytest.MonkeyPatch, *, is_behind: bool
) -> None:
    used, delivered = _count_foreseen(ahead, monkeypatch), ahead._delivered

    def with_load(frame: Frame) -> Foreseen | None:
        found = delivered(frame)
        monkeypatch.setattr(ahead, "_is_behind", is_behind)
        return found

    monkeypatch.setattr(ahead, "_delivered", with_load)
    state, last = case.start, None
    for place, (frame, following) in enumerate(zip(case.frames, (*case.frames[1:], None), strict=True)):
        state, estimate, whole = ahead.step(state, *frame, following)
        assert (estimate.evidence is None) == (used[-1] and not is_behind)
        if last is not None:
            _assert_same(last(), alone[place - 1])
        last = whole
    assert last is not None
    _assert_same(last(), alone[-1])
    assert sum(used) == FRAMES - 2, "from the third frame on, for no hand was followed before the first"


def test_estimates_that_are_asked_for_late_are_the_same(
    case: Case, alone: list[Estimate], ahead: ScenesAhead, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pictures of fingers that are not judged yet are not written over."""
    delivered = ahead._delivered

    def in_time(frame: Frame) -> Foreseen | None:
        found = delivered(frame)
        monkeypatch.setattr(ahead, "_is_behind", False)
        return found

    monkeypatch.setattr(ahead, "_delivered", in_time)
    state, all_whole = case.start, []
    for frame, following in zip(case.frames, (*case.frames[1:], None), strict=True):
        state, _, whole = ahead.step(state, *frame, following)
        all_whole.append(whole)
    for whole, expected in reversed(list(zip(all_whole, alone, strict=True))):
        _assert_same(whole(), expected)


def test_what_was_made_for_another_frame_is_not_used(
    case: Case, alone: list[Estimate], ahead: ScenesAhead, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = _count_foreseen(ahead, monkeypatch)
    state = case.start
    for place, frame in enumerate(case.frames):
        wrong = case.frames[0][0], frame[1] + 1 / FPS  # the pictures of another time
        state, _, whole = ahead.step(state, *frame, wrong)
        _assert_same(whole(), alone[place])
    assert sum(used) == 0


def test_a_frame_without_pictures_is_not_ordered(case: Case, ahead: ScenesAhead) -> None:
    state, empty = case.start, [View() for _ in case.frames[0][0]]
    for frame in case.frames[:2]:
        state, _, _ = ahead.step(state, *frame, None)
    state, _, _ = ahead.step(state, *case.frames[2], (empty, 3 / FPS))
    _, estimate, _ = ahead.step(state, empty, 3 / FPS)
    assert estimate.status == "no_hand"


def test_an_error_over_there_is_told(case: Case) -> None:
    with ScenesAhead(partial(Tracker, case.make.args[0], ()), case.make()) as broken:
        with pytest.raises(ValueError, match="at least one"):
            case.make.func(case.make.args[0], ())
        with pytest.raises(RuntimeError, match="cameras: expected at least one"):
            broken.wait()


def test_a_process_that_was_ended_from_outside_is_told_in_one_line(case: Case) -> None:
    def tracked(ahead: ScenesAhead, state: TrackerState, first: int) -> TrackerState:
        for place in (first, first + 1):
            state, _, _ = ahead.step(state, *case.frames[place], case.frames[place + 1])
        return state

    with ScenesAhead(case.make, case.make()) as ahead:
        ahead.wait()
        state = tracked(ahead, case.start, 0)
        ahead._process.kill()
        with pytest.raises(
            InputError, match=r"^the process that makes scenes was ended from outside, .* \(signal 9\)$"
        ):
            tracked(ahead, state, 2)


def _count_foreseen(ahead: ScenesAhead, monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether each step of its tracker is given a scene that was made ahead."""
    tracker, used = ahead._tracker, list[bool]()
    step = tracker.step

    def noted(*args, **named):
        used.append(named.get("foreseen") is not None)
        return step(*args, **named)

    monkeypatch.setattr(tracker, "step", noted)
    return used
