"""The tracker on contours step by step: followed, lost, recovered, saved, and what it says of its certainty."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.steps import (
    FRAME_S,
    assert_complete,
    assert_empty,
    assert_equal,
    motion_error_px,
    points_px,
    right_hand,
    run,
    saved_and_restored,
)
from torchhand.files import load_hand_model
from torchhand.hand import DOFS
from torchhand.image import EdgeSettings
from torchhand.numerics import Gaussian, MotionModel, UnscentedSettings
from torchhand.simulate import SceneSettings
from torchhand.track import Estimate, Tracker, TrackerSettings, TrackerState, View
from torchhand.track.belief import NoiseSettings
from torchhand.track.proposals import Proposals, Proposed
from torchhand.track.scene import HealthSettings
from torchhand.track.unscented import UnscentedUpdateSettings
from torchhand.view import HandProjector

DARK = SceneSettings(supersampling=2, background="dark", noise=2.0)
Followed = tuple[Tracker, list[Estimate], list[TrackerState]]


def _tracker(film: Any, settings: TrackerSettings | None = None, **options: Any) -> Tracker:
    return Tracker(right_hand(), film.camera, settings, **options)


def _update(**changes: Any) -> TrackerSettings:
    return TrackerSettings(update=UnscentedUpdateSettings(**changes))


def _bare(film: Any) -> Tensor:
    """The scene without the hand."""
    bare = film.images[0].clone()
    bare[:] = film.images[0][0, 0]
    return bare


@pytest.fixture(scope="module")
def film(studio: Any) -> Any:
    """A hand in planar motion, 14 frames."""
    return studio.film("planar", 14, pace=3.0)


@pytest.fixture(scope="module")
def followed(film: Any) -> Followed:
    tracker = _tracker(film)
    state, estimates, states = None, [], []
    for image in film.images:
        state, (estimate,) = run(tracker, [image], state)
        estimates.append(estimate)
        states.append(state)
    return tracker, estimates, states


def test_planar_motion_is_followed(film: Any, followed: Followed) -> None:
    tracker, estimates, states = followed
    assert [estimate.status for estimate in estimates] == ["tracked"] * 14
    assert [estimate.is_new for estimate in estimates] == [True] + [False] * 13
    assert float((film.keypoints_px - film.keypoints_px[0]).norm(dim=-1).max()) > 10.0  # there is something to follow
    assert float(motion_error_px(estimates, film.keypoints_px).square().mean().sqrt()) < 0.5
    for estimate in estimates:
        assert_complete(estimate)
        assert (estimate.overlap or 0) > 0.85
        assert (estimate.edges or 0) > 0.9
    pose, keypoints, seen = estimates[5].pose, estimates[5].keypoints, estimates[5].keypoints_px
    assert pose is not None
    assert keypoints is not None
    assert seen is not None
    frames = tracker.kinematics(pose, states[5].shape)  # the pose is absolute
    torch.testing.assert_close(frames.keypoints, keypoints, rtol=0, atol=1e-9)
    torch.testing.assert_close(film.camera.project(frames.keypoints), seen[0], rtol=0, atol=1e-6)
    at = tracker.pose_of(states[5])
    assert at is not None
    torch.testing.assert_close(frames.rotation[0], at.rotation, rtol=0, atol=1e-9)


def test_only_free_parameters_move(followed: Followed) -> None:
    _, estimates, states = followed
    frozen = [i for i, dof in enumerate(DOFS) if dof not in ("root_tx", "root_ty", "root_rx", "root_ry", "root_rz")]
    assert states[0].hand is not None
    for estimate in estimates:
        assert estimate.pose is not None
        assert estimate.pose_std is not None
        torch.testing.assert_close(estimate.pose[frozen], states[0].hand.base[frozen], rtol=0, atol=1e-12)
        assert bool((estimate.pose_std[frozen] == 0).all())
    free = [DOFS.index(name) for name in ("root_tx", "root_ty", "root_rz")]
    assert estimates[-1].pose_std is not None
    assert bool((estimates[-1].pose_std[free] > 0).all())


def test_a_camera_that_is_somewhere_gives_poses_in_its_own_frame(film: Any, followed: Followed) -> None:
    quarter = torch.tensor(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), dtype=torch.float64)
    camera = replace(film.camera, rotation=quarter, translation=torch.tensor((0.3, 0.1, 2.0), dtype=torch.float64))
    _, estimates = run(Tracker(right_hand(), camera), film.images[:2])
    assert_equal(estimates[1], followed[1][1])


def test_the_same_pictures_give_the_same_numbers(film: Any, followed: Followed) -> None:
    for one, other in zip(run(_tracker(film), film.images[:5])[1], followed[1][:5], strict=True):
        assert_equal(one, other)


def test_a_float32_hand_is_not_changed(film: Any, followed: Followed) -> None:
    hand = load_hand_model().hand(side="right", dtype=torch.float32)
    tracker = Tracker(hand, film.camera)
    assert hand.shape.dtype == torch.float32
    assert tracker.kinematics.default_shape.dtype == torch.float64
    _, first = run(tracker, film.images[:1])
    assert float((points_px(first)[0] - points_px(followed[1][:1])[0]).norm(dim=-1).max()) < 0.05


@pytest.mark.parametrize("at", [0, 6])
def test_a_saved_state_goes_on_bit_for_bit(at: int, film: Any, followed: Followed) -> None:
    _, estimates, states = followed
    _, rest = run(_tracker(film), film.images[at + 1 : at + 4], saved_and_restored(states[at]))
    for one, other in zip(rest, estimates[at + 1 : at + 4], strict=True):
        assert_equal(one, other)


def test_a_hand_that_vanishes_is_lost_and_recovered(film: Any, followed: Followed) -> None:
    tracker, _, states = followed
    bare = _bare(film)
    state, estimates = run(tracker, [bare, bare, film.images[3], film.images[4]], states[2])
    assert [estimate.status for estimate in estimates] == ["lost", "no_hand", "recovered", "tracked"]
    for estimate in estimates[:2]:
        assert_empty(estimate)
    for estimate in estimates[2:]:
        assert_complete(estimate)
    assert float((points_px(estimates[3:])[0] - film.keypoints_px[4]).norm(dim=-1).mean()) < 2.5
    assert state.hand.failures == 0


def test_a_jump_is_caught_at_once(film: Any, followed: Followed) -> None:
    """Frames are missing: a jump beyond the search. A frame that fails is searched afresh, not at the next due time."""
    tracker, _, states = followed
    assert tracker.settings.health.search_every > 1
    jumped = torch.roll(film.images[3], (14, -9), dims=(1, 0))
    state = replace(states[3], frames_since_search=0)
    _, estimates = run(tracker, [jumped], state)
    assert estimates[0].status == "tracked"
    assert estimates[0].is_new
    expected = film.keypoints_px[3] + torch.tensor((14.0, -9.0), dtype=torch.float64)
    assert float((points_px(estimates)[0] - expected).norm(dim=-1).mean()) < 2.5


def test_hand_coloured_things_apart_from_the_hand_do_not_count(film: Any, followed: Followed) -> None:
    tracker, estimates, states = followed
    image = film.images[4].clone()
    x, y = film.keypoints_px[4, 9].round().long().tolist()
    image[60:76, 14:30] = image[y, x]  # as far from the wrist as the fingers
    _, (estimate,) = run(tracker, [image], states[3])
    assert estimate.overlap == pytest.approx(estimates[4].overlap, abs=1e-3)


def test_a_posture_that_is_not_the_starts_is_lost_and_not_no_hand(film: Any, followed: Followed, studio: Any) -> None:
    tracker, _, states = followed
    fist = studio.placed(view="back", posed="fist", size=0.55).picture()
    _, (estimate,) = run(tracker, [fist], replace(states[0], hand=None))
    assert estimate.status == "lost"
    assert "posture of the start" in estimate.reason
    assert_empty(estimate)


def test_a_hand_is_not_followed_out_of_the_picture(film: Any, followed: Followed) -> None:
    tracker, _, states = followed
    hand = states[3].hand
    assert hand is not None
    base = hand.base.clone()
    base[0] += 2.0
    _, (estimate,) = run(tracker, [_bare(film)], replace(states[3], hand=replace(hand, base=base)))
    assert estimate.status == "lost"
    assert "0% in the picture" in estimate.reason


def test_a_gate_refuses_what_the_prediction_excludes(film: Any, followed: Followed) -> None:
    """A hand that hardly accelerates jumps by 4 px: four deviations of an edge, and the search still reaches it."""
    _, _, states = followed
    jumped, hand = torch.roll(film.images[3], 4, dims=1), states[3].hand
    assert hand is not None
    certain = replace(hand, belief=Gaussian(hand.belief.mean, 1e-3 * hand.belief.covariance))
    edges = {}
    for gate in (4.0, 100.0):
        settings = TrackerSettings(
            update=UnscentedUpdateSettings(gate=gate, edge_std_px=1.0, inner_weight=0.0),
            noise=NoiseSettings(translation=0.01, rotation=0.05),
            health=HealthSettings(min_overlap=0.0, max_score_drop=1.0, max_unexplained=1.0, min_edges=0.0),
        )
        _, (estimate,) = run(_tracker(film, settings), [jumped], replace(states[3], hand=certain))
        edges[gate] = estimate.edges
    assert edges[4.0] < 0.6 * edges[100.0]


def test_a_skipped_frame_is_no_hand_and_adds_uncertainty(film: Any, followed: Followed) -> None:
    tracker, estimates, states = followed
    state, (missing,) = run(tracker, [None], states[8])
    assert missing.status == "no_hand"
    assert_empty(missing)
    before = states[8].hand
    assert before is not None
    assert bool(((state.hand.belief.covariance - before.belief.covariance).diagonal() > 0).all())
    moved = state.hand.belief.mean[:3] - before.belief.mean[:3]
    assert float(moved.abs().max()) > 0  # it goes on at the speed it had
    _, (after,) = run(tracker, film.images[10:11], state)
    assert after.status == "tracked"
    assert float((points_px([after])[0] - points_px(estimates)[10]).norm(dim=-1).mean()) < 1.0
    longer, shorter = (torch.einsum("kii->k", one.keypoints_cov) for one in (after, estimates[10]))
    assert bool((longer > shorter).all())


def test_a_track_is_given_up_after_many_skipped_frames(followed: Followed) -> None:
    tracker, _, states = followed
    state, kept = states[4], []
    for _ in range(tracker.settings.health.patience):
        state, _ = run(tracker, [None], state)
        kept.append(state.hand is not None)
    assert kept == [True, True, False]
    assert run(tracker, [None])[0].hand is None


def test_covariances_are_symmetric_and_positive(followed: Followed) -> None:
    for estimate in followed[1]:
        covariance = estimate.keypoints_cov
        assert covariance is not None
        torch.testing.assert_close(covariance, covariance.mT, rtol=0, atol=1e-15)
        assert float(torch.linalg.eigvalsh(covariance).min()) > 0.003**2


def test_a_known_hand_is_certain_of_its_distance(film: Any, followed: Followed) -> None:
    shape = film.kinematics.default_shape
    state, (first,) = run(_tracker(film, shape=shape), film.images[:1])
    assert torch.equal(state.shape, shape)
    known, fitted = (float(one.keypoints_cov[0, 2, 2]) for one in (first, followed[1][0]))  # type: ignore[index]
    length = film.kinematics.shape_space.names.index("hand_length")
    fraction = float(film.kinematics.shape_space.std[length] / shape[length])
    expected = (fraction * float(followed[1][0].keypoints[0, 2])) ** 2  # type: ignore[index]
    assert fitted - known == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    "settings",
    [
        _update(edges_in="grey"),
        _update(transform=UnscentedSettings(variant="paper")),
        # the paper's own: grey levels, the strongest edge, its printed sigma points, constant acceleration, no gate
        TrackerSettings(
            update=UnscentedUpdateSettings(
                edges_in="grey",
                outer_edges=EdgeSettings(min_strength=0.05),
                inner_edges=EdgeSettings(min_strength=0.05),
                inner_weight=1.0,
                transform=UnscentedSettings(variant="paper"),
                gate=1e6,
            ),
            motion=MotionModel(order=2),
        ),
        TrackerSettings(motion=MotionModel(order=0), noise=NoiseSettings(translation=0.5, rotation=3.0)),
        TrackerSettings(motion=MotionModel(order=1), noise=NoiseSettings(translation=3.0, rotation=15.0)),
        TrackerSettings(update=UnscentedUpdateSettings(inner_weight=0.0, passes=2), pose_space="planar_scale"),
    ],
    ids=["grey", "paper_weights", "paper", "order0", "order1", "scale"],
)
def test_configurations_follow_a_hand_on_black(settings: TrackerSettings, studio: Any) -> None:
    film = studio.film("planar", 10, pace=1.7, scene=DARK, seed=4)
    _, estimates = run(_tracker(film, settings), film.images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * 10
    assert float(motion_error_px(estimates, film.keypoints_px).square().mean().sqrt()) < 0.7


@pytest.mark.parametrize("kind", ["orthographic", "lens"])
def test_other_cameras(kind: str, studio: Any) -> None:
    camera = studio.camera(kind="orthographic" if kind == "orthographic" else "pinhole", lens=kind == "lens")
    film = studio.film("planar", 8, pace=3.0, camera=camera)
    _, estimates = run(_tracker(film), film.images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * 8
    assert float(motion_error_px(estimates, film.keypoints_px).square().mean().sqrt()) < 0.5
    last = estimates[-1]
    assert last.keypoints is not None
    assert last.keypoints_px is not None
    assert last.keypoints_cov is not None
    torch.testing.assert_close(camera.project(last.keypoints), last.keypoints_px[0], rtol=0, atol=1e-9)
    assert float((last.keypoints_px[0] - film.keypoints_px[-1]).norm(dim=-1).mean()) < 3.0
    if kind == "orthographic":  # scale is known, so the only doubt is about joint centres and the filter's own
        fingers = last.keypoints_cov[2:]  # where makers put the wrist and the thumb's root differs more
        assert float(fingers[:, 2, 2].sqrt().max()) < 0.006


def test_fingers_that_move_are_followed(studio: Any) -> None:
    settings = TrackerSettings(
        pose_space="planar_abduction",
        motion=MotionModel(order=0),
        noise=NoiseSettings(translation=0.1, rotation=1.0, angle=3.0),
    )
    film = studio.film("abduction", 22, total=40, camera=studio.camera(240, 192))
    _, estimates = run(_tracker(film, settings), film.images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * 22
    little = DOFS.index("little_mcp_aa")
    first, last = estimates[0].pose, estimates[-1].pose
    assert first is not None
    assert last is not None
    assert math.degrees(float(first[little] - last[little])) > 4.0
    assert float((points_px(estimates) - film.keypoints_px)[-1].norm(dim=-1).mean()) < 4.0


def test_joint_limits_hold_at_every_frame(studio: Any) -> None:
    settings = TrackerSettings(
        pose_space="dof27",
        motion=MotionModel(order=0),
        noise=NoiseSettings(translation=0.5, rotation=10.0, angle=60.0),  # it may go anywhere
        update=UnscentedUpdateSettings(transform=UnscentedSettings(alpha=0.33)),
    )
    film = studio.film("flexion", 4, total=16)
    _, estimates = run(_tracker(film, settings), film.images)
    skeleton = film.kinematics.skeleton
    poses = torch.stack([e.pose for e in estimates if e.pose is not None])
    assert len(poses) >= 3
    assert bool((poses[:, 6:] >= skeleton.lower - 1e-9).all())
    assert bool((poses[:, 6:] <= skeleton.upper + 1e-9).all())
    assert bool(((poses[:, 6:] - skeleton.lower).abs() < 1e-9).any())  # some joint is at its limit


def test_start_points_are_used_once_and_evaluated(film: Any) -> None:
    wrist, tip = film.keypoints_px[0, 0].tolist(), film.keypoints_px[0, 12].tolist()
    _, estimates = run(_tracker(film, start_points=(*wrist, *tip)), film.images[:2])
    assert [estimate.status for estimate in estimates] == ["tracked"] * 2
    assert float((points_px(estimates)[1] - film.keypoints_px[1]).norm(dim=-1).mean()) < 3.0
    state, (estimate,) = run(_tracker(film, start_points=(8.0, 60.0, 40.0, 20.0)), film.images[:1])
    assert estimate.status == "no_hand"
    assert_empty(estimate)
    assert state.hand is None
    assert not state.has_started


@pytest.mark.parametrize("time_s", [0.0, -1.0, math.nan, math.inf])
def test_a_time_that_cannot_be(time_s: float, film: Any) -> None:
    tracker, empty = _tracker(film), (View(),)
    state, _ = tracker.step(None, empty, 0.0)
    with pytest.raises(ValueError, match=r"time_s: expected a finite time after 0.0, got"):
        tracker.step(state, empty, time_s)


def test_pictures_that_are_not_the_cameras(film: Any) -> None:
    tracker = _tracker(film)
    with pytest.raises(ValueError, match=r"views\[0\].image: expected 200×160 px as the camera says, got 160×200 px"):
        run(tracker, [torch.zeros(200, 160, 3, dtype=torch.uint8)])
    with pytest.raises(ValueError, match=r"views: expected one per camera, 1, got 2"):
        tracker.step(None, (View(), View()), 0.0)


def test_gradients_flow_after_tracking_in_the_same_process(studio: Any) -> None:
    """What is kept for reuse must not be kept as an inference tensor."""
    film = studio.film("planar", 3, total=40, camera=studio.camera(240, 192))
    tracker = _tracker(film)
    run(tracker, film.images[:2])
    pose = torch.zeros(2, 36, dtype=torch.float64)
    pose[:, 2] = 0.5
    pose.requires_grad_()
    shape = film.kinematics.default_shape.clone().requires_grad_()
    projector = HandProjector(tracker.kinematics, film.camera, shape)
    projector.outline_px(pose, torch.eye(3, dtype=torch.float64), studio.table).sum().backward()
    assert pose.grad is not None
    assert shape.grad is not None
    assert float(pose.grad.abs().sum()) > 0
    assert float(shape.grad.abs().sum()) > 0


@pytest.mark.parametrize(
    ("every", "is_lamp", "is_right"), [(2, False, True), (0, False, True), (2, True, True), (0, True, False)]
)
def test_the_colours_follow_changing_light(studio: Any, every: int, is_lamp: bool, is_right: bool) -> None:
    """The light goes down to a half and turns red within 24 frames: that of the whole scene is told by the picture;
    where it is that of a lamp on the hand, in less than half of the picture, colours of the start alone lose the hand.
    """
    film = studio.film("planar", 24, scene=SceneSettings(supersampling=2, background="plain", noise=2.0))
    dimmed = 1 + torch.linspace(0, 1, 24)[:, None] * (torch.tensor((0.55, 0.4, 0.3)) - 1)
    lit = torch.ones(film.images[0].shape[:2], dtype=torch.bool)
    if is_lamp:
        points = film.keypoints_px.flatten(0, -2)
        left, top, right, bottom = (*(points.amin(0) - 12).int().tolist(), *(points.amax(0) + 12).int().tolist())
        lit[:] = False
        lit[max(0, top) : bottom, max(0, left) : right] = True
        assert float(lit.float().mean()) < 0.5
    images = [
        torch.where(lit[..., None], (image * fraction).round().to(torch.uint8), image)
        for image, fraction in zip(film.images, dimmed, strict=True)
    ]
    settings = TrackerSettings(colour_update_every=every)
    _, estimates = run(_tracker(film, settings, shape=film.kinematics.default_shape), images)
    assert [estimate.status for estimate in estimates[:12]] == ["tracked"] * 12
    last = estimates[-1]
    assert ((last.overlap or 0.0) > 0.8) == is_right
    if is_right:
        assert float((points_px([last])[0] - film.keypoints_px[-1]).norm(dim=-1).mean()) < 2.0


def test_a_correction_that_turns_the_hand_over_must_explain_more(film: Any, followed: Followed) -> None:
    """A proposed hand takes over by what it explains more, and needs the more of that the more it is turned."""
    first, _, states = followed
    settings = TrackerSettings(health=HealthSettings(max_score_drop=0.0, search_every=1, better_by=0.0, turned_by=0.1))
    tracker = _tracker(film, settings)
    state = replace(states[0], usual_score=1.0, frames_since_search=5)
    _, followed_on = run(first, film.images[1:2], states[0])
    score = followed_on[0].score
    assert score < 0.98
    scene = tracker.scene(state, (View(image=film.images[1]),), FRAME_S)
    at = tracker.pose_of(states[1])
    assert at is not None
    assert state.shape is not None
    own = first.parts.rule.begin(at, torch.eye(6, dtype=torch.float64) * 1e-6, scene, state.shape)
    assert own is not None
    turn = torch.diag(torch.tensor((-1.0, 1.0, -1.0), dtype=torch.float64))
    for rotation, more, takes_over in (
        (torch.eye(3, dtype=torch.float64), 0.01, True),
        (turn, 0.01, False),
        (turn, 0.11, True),
    ):
        pose = replace(own.pose, reference=rotation @ own.pose.reference)
        overlaps = torch.tensor([score + more], dtype=torch.float64)
        better = replace(own, pose=pose, agreement=replace(own.agreement, overlaps=overlaps))
        assert _with_proposal(tracker, better, state, film.images[1]).is_new == takes_over


def _with_proposal(tracker: Tracker, candidate: Any, state: TrackerState, image: Tensor) -> Estimate:
    """The estimate where a source of proposals finds this candidate, judged as it is."""

    class Source:
        occasion = "search"

        def __call__(self, *_: Any) -> Proposals:
            proposed = Proposed(pose=candidate.pose, covariance=None, candidate=candidate)
            return Proposals(hands=(proposed,), has_foreground=True)

    tracker.parts = replace(tracker.parts, sources=(Source(),), takes_proposals=True)
    return run(tracker, [image], state)[1][0]
