"""The second pass over simulated pictures whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import HandKinematics
from torchhand.runs import settings_of
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.track import Estimate, FittedShape, FurtherPass, Tracker, TrackerState, View
from torchhand.track.further_pass import is_borne_out

WIDTH, HEIGHT, FPS, FRAMES = 240, 192, 30.0, 12


@pytest.fixture(scope="module")
def camera() -> Camera:
    return replace(assumed_camera(WIDTH, HEIGHT, horizontal_fov_deg=48.0), is_assumed=False)


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics(dtype=torch.float64)


@pytest.fixture(scope="module")
def scene(kinematics: HandKinematics, camera: Camera) -> tuple[list[tuple[View]], torch.Tensor]:
    """Views, and the keypoints in the pictures."""
    generator = torch.Generator().manual_seed(3)
    motion = scripted_motion("planar", FRAMES, kinematics, camera, generator)
    frames = list(render_sequence(kinematics, motion, camera, SceneSettings(noise=3.0), generator))
    return [(View(image=frame.image),) for frame in frames], torch.stack([frame.keypoints_px for frame in frames])


@pytest.fixture(scope="module")
def tracker(camera: Camera) -> Tracker:
    return Tracker(load_hand_model().hand(side="right", dtype=torch.float64), camera, settings_of("contour_planar"))


@pytest.fixture(scope="module")
def forward(tracker: Tracker, scene: tuple) -> tuple[TrackerState, list[Estimate]]:
    state, found = None, []
    for index, views in enumerate(scene[0]):
        state, estimate = tracker.step(state, views, index / FPS)
        found.append(estimate)
    assert state is not None
    return state, found


def test_a_hand_that_was_lost_early_is_followed_back_from_where_it_was_found(
    tracker: Tracker, scene: tuple, forward: tuple[TrackerState, list[Estimate]]
) -> None:
    (views, true_px), (state, found) = scene, forward
    second = FurtherPass(tracker, state)
    back = [second.step(views[i], i / FPS, found[i].pose if i >= 6 else None) for i in reversed(range(FRAMES))][::-1]
    assert [one.estimate.time_s for one in back] == [i / FPS for i in range(FRAMES)]
    for i, one in enumerate(back):
        assert one.estimate.keypoints_px is not None
        missed = one.estimate.keypoints_px[0] - true_px[i]
        before = found[i].keypoints_px
        assert before is not None
        usual = float((before[0] - true_px[i]).norm(dim=-1).mean())
        assert float(missed.norm(dim=-1).mean()) < usual + 1.0
        assert (one.evidence is None) == (i < 6)  # compared where there is something to compare with


def test_nothing_is_looked_for_where_neither_pass_has_a_hand(
    tracker: Tracker, scene: tuple, forward: tuple[TrackerState, list[Estimate]], monkeypatch: pytest.MonkeyPatch
) -> None:
    second = FurtherPass(tracker, forward[0])
    monkeypatch.setattr(Tracker, "step", lambda *arguments: pytest.fail("a frame was searched"))
    assert second.step(scene[0][-1], 1.0, None).estimate.status == "no_hand"


def test_the_hand_that_the_views_bear_out_has_the_larger_evidence(
    tracker: Tracker, scene: tuple, forward: tuple[TrackerState, list[Estimate]]
) -> None:
    state, found = forward
    second = FurtherPass(tracker, state)
    pose = found[-1].pose
    assert pose is not None
    same = second.step(scene[0][-1], (FRAMES - 1) / FPS, pose)
    assert same.evidence is not None
    assert same.evidence_before is not None
    assert same.evidence == pytest.approx(same.evidence_before, abs=0.5)
    moved = pose.clone()
    moved[0] += 0.02
    off = second.step(scene[0][-2], (FRAMES - 2) / FPS, moved)
    assert off.evidence is not None
    assert off.evidence_before is not None
    assert off.evidence > off.evidence_before + 3


def test_what_uncertain_proportions_leave_open_is_in_the_covariances_of_keypoints(
    tracker: Tracker, scene: tuple, forward: tuple[TrackerState, list[Estimate]]
) -> None:
    state, found = forward
    assert state.shape is not None
    nothing, root = torch.zeros(1, dtype=torch.float64), 0.01 * torch.rand(21, 3, 3, dtype=torch.float64)
    fitted = FittedShape(
        shape=state.shape,
        shape_std=torch.zeros_like(state.shape),
        keypoints_cov=root @ root.mT,
        costs=nothing,
        costs_before=nothing,
    )
    known, unsure = (
        FurtherPass(tracker, state, fitted=own).step(scene[0][-1], 1.0, found[-1].pose).estimate
        for own in (None, fitted)
    )
    assert known.keypoints is not None
    assert known.keypoints_cov is not None
    assert unsure.keypoints is not None
    assert unsure.keypoints_cov is not None
    assert torch.equal(known.keypoints, unsure.keypoints)
    torch.testing.assert_close(unsure.keypoints_cov, known.keypoints_cov + root @ root.mT, rtol=1e-12, atol=0)


def test_a_tracker_that_never_found_a_hand_has_nothing_to_follow(tracker: Tracker) -> None:
    with pytest.raises(ValueError, match="state: expected one of a tracker that has found a hand"):
        FurtherPass(tracker, TrackerState())


def test_time_runs_backwards_for_the_motion_only(
    tracker: Tracker, scene: tuple, forward: tuple[TrackerState, list[Estimate]]
) -> None:
    """The second pass of a second pass is the first one again, up to what is learned on the way."""
    state, found = forward
    second = FurtherPass(tracker, state)
    back = [second.step(scene[0][i], i / FPS, found[i].pose).estimate for i in reversed(range(FRAMES))][::-1]
    apart = [
        float((one.keypoints - other.keypoints).norm(dim=-1).mean())
        for one, other in zip(back, found, strict=True)
        if one.keypoints is not None and other.keypoints is not None
    ]
    assert len(apart) == FRAMES
    assert np.median(apart) < 0.003


def test_the_scene_of_a_step_is_made_once(
    tracker: Tracker, scene: tuple, forward: tuple[TrackerState, list[Estimate]]
) -> None:
    views, state = scene[0], forward[0]
    known, _ = tracker.step(state, views[0], FRAMES / FPS)
    own = tracker.scene(known, views[0], FRAMES / FPS)
    before = tracker.parts.segmentation.scene(views[0], known.appearance, FRAMES / FPS)
    plane = before.plane(0)
    assert plane is not None
    own_plane = own.plane(0)
    assert own_plane is not None
    assert torch.equal(own_plane, plane)
    assert tracker.scene(known, views[0], FRAMES / FPS) is own
    other = tracker.scene(known, views[1], FRAMES / FPS)  # other pictures, the same time
    other_plane = other.plane(0)
    assert other_plane is not None
    assert not torch.equal(other_plane, plane)
    assert tracker.scene(known, views[0], 1 + FRAMES / FPS).time_s == 1 + FRAMES / FPS


@pytest.mark.parametrize(
    ("turn", "overlap", "is_firm", "expected"),
    [
        (0.5, 0.85, True, True),
        (0.5, 0.75, True, False),  # it slid away
        (3.1, 0.92, True, False),
        (3.1, 0.96, True, True),
        (3.1, 0.92, False, True),
    ],
)
def test_a_likelier_hand_keeps_its_overlap_and_gains_some_where_it_faces_away(
    turn: float, overlap: float, is_firm: bool, expected: bool
) -> None:
    pose = torch.zeros(36, dtype=torch.float64)
    other = pose.clone()
    other[4] = turn
    followed = Estimate(status="tracked", time_s=0.0, pose=pose, overlap=0.9)
    likelier = replace(followed, pose=other, overlap=overlap)
    assert is_borne_out(followed, likelier, is_firm=is_firm) is expected
