"""Proportions that one camera tells while it follows a hand of which it knows none."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.steps import saved_and_restored
from tests.studio import Studio
from torchhand.files import load_hand_model
from torchhand.fit import Stage
from torchhand.hand import HandPose
from torchhand.runs import settings_of
from torchhand.track import Tracker, TrackerState, View
from torchhand.track.proportions import OutlineShape
from torchhand.track.scene import Candidate, Scene
from torchhand.track.unscented import UnscentedUpdate

WIDTH, HEIGHT = 240, 192
POSTURES = ("open", "point", "flat", "victory")
SETTINGS = replace(settings_of("contour_full"), learned_posture=False, learned_proposals=False, shape_frames=4)


@pytest.fixture(autouse=True)
def independent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated pictures have no errors in common; a short schedule finds the proportions as well."""
    monkeypatch.setattr(UnscentedUpdate, "overconfidence", 1.0)
    monkeypatch.setattr("torchhand.track.assembly.SCHEDULE", (Stage(gross_m=0.0075, rounds=1, iterations=3),))


def tracker_of(studio: Studio, *, shape: Tensor | None = None, accumulates: bool = True) -> Tracker:
    hand = load_hand_model().hand(side="right", dtype=torch.float64)
    camera = studio.camera(WIDTH, HEIGHT)
    return Tracker(hand, camera, SETTINGS, shape=shape, accumulates_shape=accumulates)


def outlines_of(tracker: Tracker) -> OutlineShape:
    found = tracker.parts.accumulated_shape
    assert isinstance(found, OutlineShape)
    return found


@pytest.fixture(scope="module")
def person(studio: Studio) -> Tensor:
    """A hand with thicker fingers than most."""
    space = studio.kinematics().shape_space
    is_breadth = torch.tensor([name == "hand_breadth" for name in space.names])
    return space.default + torch.where(is_breadth, 1.5 * space.std, 0.0)


@pytest.fixture(scope="module")
def seen(studio: Studio, person: Tensor) -> list[tuple[Scene, Candidate]]:
    """Four postures of the hand, followed as one of usual proportions."""
    tracker, found = tracker_of(studio), []
    shape = tracker.kinematics.default_shape
    state = TrackerState(shape=shape, shape_frames=())
    for index, posed in enumerate(POSTURES):
        camera = studio.camera(WIDTH, HEIGHT)
        hand = studio.placed(view="back", posed=posed, shape=person, angle_deg=8.0 * index, size=0.7, camera=camera)
        scene = tracker.scene(state, [View(mask=hand.mask)], index / 30)
        candidate = tracker.candidate(HandPose(dofs=hand.pose, reference=hand.root_reference), scene, shape)
        assert candidate is not None
        found.append((scene, candidate))
    return found


def followed(tracker: Tracker, seen: list[tuple[Scene, Candidate]], *, fits: bool = True) -> list[TrackerState]:
    outlines, found = outlines_of(tracker), []
    state = TrackerState(shape=tracker.kinematics.default_shape, shape_frames=())
    for scene, candidate in seen:
        state = outlines(state, candidate, scene, fits=fits)
        found.append(state)
    return found


def kept(states: list[TrackerState]) -> list[int | None]:
    return [None if state.shape_frames is None else len(state.shape_frames) for state in states]


def test_frames_are_kept_that_show_the_hand_otherwise_until_there_are_enough(
    studio: Studio, seen: list[tuple[Scene, Candidate]]
) -> None:
    tracker = tracker_of(studio)
    states = followed(tracker, [pair for pair in seen for _ in range(2)], fits=False)
    assert kept(states) == [1, 1, 2, 2, 3, 3, 4, 4]
    doubtful = replace(seen[1][1], is_sound=False)
    assert kept(followed(tracker, [seen[0], (seen[1][0], doubtful)], fits=False)) == [1, 1]
    score = tracker.parts.health.score(seen[0][1])
    for best, count in ((score + 0.01, 1), (score + 0.03, 0)):  # of the frames before
        state = TrackerState(shape=tracker.kinematics.default_shape, shape_frames=(), best_score=best)
        state = outlines_of(tracker)(state, seen[0][1], seen[0][0], fits=False)
        assert kept([state]) == [count]


def test_proportions_of_the_person_are_found_and_stand(
    studio: Studio, seen: list[tuple[Scene, Candidate]], person: Tensor
) -> None:
    tracker = tracker_of(studio)
    states = followed(tracker, [*seen, *seen])
    assert kept(states) == [1, 2, 3, None, None, None, None, None]
    last, space, default = states[3].shape, tracker.kinematics.shape_space, tracker.kinematics.default_shape
    assert last is not None
    assert states[2].shape is not None
    assert torch.equal(states[2].shape, default)  # what nothing judges is not believed
    assert states[2].shape_keypoints_cov is None
    left_open = states[-1].shape_keypoints_cov
    assert left_open is not None
    across, along = left_open.diagonal(dim1=-2, dim2=-1).sqrt().split((2, 1), -1)  # the line of sight
    assert bool((along > across).all())  # what outlines hold is across it
    assert 5e-4 < float(across.mean()) < 5e-3
    is_radius = torch.tensor([name.endswith(("pip_radius", "dip_radius")) for name in space.names])
    found, true, usual = (space.metres(one)[is_radius].mean() for one in (last, person, default))
    assert abs(found - true) < 0.8 * abs(usual - true)
    assert states[-1].shape is last


def test_a_step_that_must_be_quick_keeps_frames_for_a_fit_that_is_the_same_after_a_kill(
    studio: Studio, seen: list[tuple[Scene, Candidate]]
) -> None:
    tracker = tracker_of(studio)
    whole, quick = followed(tracker, seen)[-1], followed(tracker, seen, fits=False)[-1]
    assert tracker.is_reshape_due(quick)
    fitted = tracker.reshaped(saved_and_restored(quick))
    assert not tracker.is_reshape_due(fitted)
    assert fitted.shape_frames is None
    assert fitted.shape is not None
    assert whole.shape is not None
    torch.testing.assert_close(fitted.shape, whole.shape, rtol=0, atol=2e-3)  # that one came by two earlier fits


def test_of_a_picture_the_part_about_the_hand_is_kept(studio: Studio) -> None:
    tracker, camera = tracker_of(studio), studio.camera(WIDTH, HEIGHT)
    outlines, shape = outlines_of(tracker), tracker.kinematics.default_shape
    hand = studio.placed(view="back", posed="open", shape=shape, size=0.3, camera=camera)
    state = TrackerState(shape=shape, shape_frames=())
    image = torch.randint(255, (HEIGHT, WIDTH, 3), dtype=torch.uint8)
    scene = tracker.scene(state, [View(image=image, mask=hand.mask)], 0.0)
    pose = HandPose(dofs=hand.pose, reference=hand.root_reference)
    candidate = tracker.candidate(pose, scene, shape)
    assert candidate is not None
    frames = outlines(state, candidate, scene, fits=False).shape_frames
    assert frames is not None
    [view], (top, left) = frames[0].views, frames[0].corner
    assert view.image is not None
    assert view.mask is not None
    assert view.mask.numel() < 0.6 * hand.mask.numel()
    assert bool(view.mask.sum() == hand.mask.sum())
    points = camera.project(tracker.kinematics(hand.pose, shape, root_reference=hand.root_reference).keypoints)
    height, width = view.mask.shape
    first, last = torch.tensor([left, top]), torch.tensor([left + width, top + height])
    assert bool(((points > first) & (points < last)).all())
    whole = outlines._whole(frames[0])
    assert whole.mask is not None
    assert torch.equal(whole.mask, hand.mask)
    assert whole.image is not None
    assert whole.image.shape == image.shape
    assert torch.equal(whole.image[top : top + height, left : left + width], view.image)


def test_contradicted_proportions_are_not_taken(
    studio: Studio, seen: list[tuple[Scene, Candidate]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torchhand.track.proportions.fitted.FittedShape.is_contradicted", True)
    last = followed(tracker_of(studio), seen)[-1]
    assert last.shape_frames is None  # and no others are looked for
    assert last.shape is not None
    assert torch.equal(last.shape, studio.kinematics().default_shape)


def test_given_proportions_and_those_of_a_recording_are_not_fitted_on_the_way(studio: Studio, person: Tensor) -> None:
    views = [View(mask=torch.zeros(HEIGHT, WIDTH, dtype=torch.bool))]
    for tracker in (tracker_of(studio, shape=person), tracker_of(studio, accumulates=False)):
        assert tracker.parts.accumulated_shape is None
        state, _ = tracker.step(None, views, 0.0)
        assert state.shape_frames is None
        assert not tracker.is_reshape_due(state)
