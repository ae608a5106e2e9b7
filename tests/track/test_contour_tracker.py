"""The contour tracker step by step: followed, lost, recovered, saved, repeated, and what it says of its certainty."""

import io
import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS
from torchhand.image import EdgeSettings
from torchhand.numerics import Gaussian, MotionModel, UnscentedSettings
from torchhand.simulate import SceneSettings
from torchhand.track.contour_tracker import ContourTracker, Estimate, Memory, TrackerState
from torchhand.track.settings import ContourTrackerSettings, LightSettings, LossSettings, NoiseSettings
from torchhand.view import HandProjector

DARK = SceneSettings(supersampling=2, background="dark", noise=2.0)
_NUMBERS = [field.name for field in fields(Estimate) if field.name not in ("status", "reason")]


def _run(
    tracker: ContourTracker,
    images: Sequence[Tensor],
    state: TrackerState | None = None,
    memory: Memory | None = None,
) -> tuple[Any, Any, list[Any]]:
    memory, estimates = memory or Memory(), []
    with torch.no_grad():
        for image in images:
            state, memory, estimate = tracker.step(state, memory, image)
            estimates.append(estimate)
    return state, memory, estimates


def _off_px(estimates: Sequence[Estimate], truth: Tensor) -> Tensor:
    """Error of the keypoints' motion since the first frame, mean over the points: joint centres may differ a bit."""
    points = torch.stack([estimate.keypoints_px for estimate in estimates if estimate.keypoints_px is not None])
    assert len(points) == len(truth)
    return ((points - points[0]) - (truth - truth[0])).norm(dim=-1).mean(-1)


def _assert_equal(one: Estimate, other: Estimate) -> None:
    for field in fields(Estimate):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert torch.equal(a, b) if isinstance(a, Tensor) else a == b, field.name


def _assert_complete(estimate: Estimate) -> None:
    for name in ("pose", "pose_std", "root_rotation", "keypoints", "keypoints_px", "keypoints_cov"):
        value = getattr(estimate, name)
        assert value is not None, name
        assert bool(value.isfinite().all()), name
    assert estimate.overlap is not None
    assert estimate.found is not None
    assert estimate.reason == ""


def _assert_empty(estimate: Estimate) -> None:
    assert [name for name in _NUMBERS if getattr(estimate, name) is not None] == []
    assert estimate.reason


@pytest.fixture(scope="module")
def film(studio: Any) -> Any:
    """A hand in planar motion, 14 frames."""
    return studio.film("planar", 14, pace=3.0)


@pytest.fixture(scope="module")
def followed(film: Any) -> tuple[ContourTracker, Memory, list[Estimate], list[TrackerState]]:
    tracker = ContourTracker(film.kinematics, film.camera, 30.0)
    state, memory, estimates, states = None, Memory(), [], []
    for image in film.images:
        state, memory, (estimate,) = _run(tracker, [image], state, memory)
        assert state is not None
        estimates.append(estimate)
        states.append(state)
    return tracker, memory, estimates, states


def test_planar_motion_is_followed(film: Any, followed: Any) -> None:
    _, memory, estimates, _ = followed
    assert [estimate.status for estimate in estimates] == ["tracked"] * 14
    assert float((film.keypoints_px - film.keypoints_px[0]).norm(dim=-1).max()) > 10.0  # there is something to follow
    assert float(_off_px(estimates, film.keypoints_px).square().mean().sqrt()) < 0.5
    for estimate in estimates:
        _assert_complete(estimate)
        assert estimate.overlap > 0.85
        assert estimate.found > 0.9
    frames = film.kinematics(estimates[5].pose, memory.shape)  # the pose is absolute
    torch.testing.assert_close(frames.keypoints, estimates[5].keypoints, rtol=0, atol=1e-9)
    torch.testing.assert_close(film.camera.project(frames.keypoints), estimates[5].keypoints_px, rtol=0, atol=1e-6)
    torch.testing.assert_close(frames.rotation[0], estimates[5].root_rotation, rtol=0, atol=1e-9)


def test_only_free_parameters_move(followed: Any) -> None:
    _, _, estimates, states = followed
    held = [i for i, dof in enumerate(DOFS) if dof not in ("root_tx", "root_ty", "root_rx", "root_ry", "root_rz")]
    for estimate in estimates:
        torch.testing.assert_close(estimate.pose[held], states[0].base[held], rtol=0, atol=1e-12)
        assert bool((estimate.pose_std[held] == 0).all())
    free = [DOFS.index(name) for name in ("root_tx", "root_ty", "root_rz")]
    assert bool((estimates[-1].pose_std[free] > 0).all())


def test_a_camera_that_is_somewhere_gives_poses_in_its_own_frame(film: Any, followed: Any) -> None:
    quarter = torch.tensor(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), dtype=torch.float64)
    camera = replace(film.camera, rotation=quarter, translation=torch.tensor((0.3, 0.1, 2.0), dtype=torch.float64))
    _, _, estimates = _run(ContourTracker(film.kinematics, camera, 30.0), film.images[:2])
    _assert_equal(estimates[1], followed[2][1])


def test_the_same_pictures_give_the_same_numbers(film: Any, followed: Any) -> None:
    tracker = ContourTracker(film.kinematics, film.camera, 30.0)
    for one, other in zip(_run(tracker, film.images[:5])[2], followed[2][:5], strict=True):
        _assert_equal(one, other)


class _Threads(TorchDispatchMode):
    """Records with how many threads every operation computes."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[int] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.seen.add(torch.get_num_threads())
        return func(*args, **(kwargs or {}))


def test_every_operation_of_a_step_has_one_thread(film: Any, followed: Any) -> None:
    tracker, memory, _, states = followed
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    with torch.no_grad(), _Threads() as threads:
        tracker.step(states[0], memory, film.images[1])
    after = torch.get_num_threads()
    torch.set_num_threads(before)
    assert threads.seen == {1}
    assert after == 3


def test_a_float32_hand_is_not_changed(film: Any, followed: Any) -> None:
    kinematics = load_hand_model().kinematics()
    tracker = ContourTracker(kinematics, film.camera, 30.0)
    assert kinematics.default_shape.dtype == torch.float32
    assert tracker.kinematics.default_shape.dtype == torch.float64
    _, _, (first,) = _run(tracker, film.images[:1])
    assert float((first.keypoints_px - followed[2][0].keypoints_px).norm(dim=-1).max()) < 0.05


@pytest.mark.parametrize("at", [0, 6])
def test_a_saved_state_goes_on_bit_for_bit(at: int, film: Any, followed: Any) -> None:
    tracker, _, estimates, states = followed
    _, memory, _ = _run(tracker, film.images[:1])
    # what is remembered changes by the frame count alone
    memory = replace(memory, frames_since_search=at)
    file = io.BytesIO()
    torch.save(tracker.state_dict(states[at], memory), file)
    file.seek(0)
    state, again = ContourTracker(film.kinematics, film.camera, 30.0).restore(torch.load(file, weights_only=True))
    _, _, rest = _run(tracker, film.images[at + 1 : at + 4], state, again)
    for one, other in zip(rest, estimates[at + 1 : at + 4], strict=True):
        _assert_equal(one, other)


def test_nothing_known_is_saved_too(film: Any) -> None:
    tracker = ContourTracker(film.kinematics, film.camera, 30.0)
    file = io.BytesIO()
    torch.save(tracker.state_dict(None, Memory()), file)
    file.seek(0)
    state, memory = tracker.restore(torch.load(file, weights_only=True))
    assert state is None
    assert memory == Memory()


def test_a_hand_that_vanishes_is_lost_and_recovered(film: Any, followed: Any) -> None:
    tracker, _, _, states = followed
    _, memory, _ = _run(tracker, film.images[:1])
    bare = film.images[0].clone()
    bare[:] = film.images[0][0, 0]
    state, memory, estimates = _run(tracker, [bare, bare, film.images[3], film.images[4]], states[2], memory)
    assert [estimate.status for estimate in estimates] == ["lost", "no_hand", "recovered", "tracked"]
    for estimate in estimates[:2]:
        _assert_empty(estimate)
    for estimate in estimates[2:]:
        _assert_complete(estimate)
    off = (estimates[3].keypoints_px - film.keypoints_px[4]).norm(dim=-1).mean()
    assert float(off) < 2.5
    assert state is not None
    assert state.failures == 0


def test_a_sudden_jump_is_caught_at_once(film: Any, followed: Any) -> None:
    """Frames are missing: a jump beyond the search. A frame that fails is searched afresh, not at the next due time."""
    tracker, _, _, states = followed
    _, memory, _ = _run(tracker, film.images[:1])
    assert tracker.settings.loss.search_every > 1
    jumped = torch.roll(film.images[3], (14, -9), dims=(1, 0))
    _, _, (estimate,) = _run(tracker, [jumped], states[3], memory)
    assert estimate.status == "tracked"
    expected = film.keypoints_px[3] + torch.tensor((14.0, -9.0), dtype=torch.float64)
    assert float((estimate.keypoints_px - expected).norm(dim=-1).mean()) < 2.5


def test_hand_coloured_things_apart_from_the_hand_do_not_count(film: Any, followed: Any) -> None:
    tracker, _, estimates, states = followed
    _, memory, _ = _run(tracker, film.images[:1])
    image = film.images[4].clone()
    x, y = film.keypoints_px[4, 9].round().long().tolist()
    image[60:76, 14:30] = image[y, x]  # as far from the wrist as the fingers
    _, _, (estimate,) = _run(tracker, [image], states[3], memory)
    assert estimate.overlap == pytest.approx(estimates[4].overlap, abs=1e-3)


def test_a_posture_that_is_not_the_starts_is_lost_and_not_no_hand(film: Any, followed: Any, studio: Any) -> None:
    tracker, _, _, _ = followed
    _, memory, _ = _run(tracker, film.images[:1])
    fist = studio.placed(view="back", posed="fist", size=0.55).picture()
    _, _, (estimate,) = _run(tracker, [fist], None, memory)
    assert estimate.status == "lost"
    assert "posture of the start" in estimate.reason
    _assert_empty(estimate)


def test_a_hand_is_not_followed_out_of_the_picture(film: Any, followed: Any) -> None:
    tracker, _, _, states = followed
    _, memory, _ = _run(tracker, film.images[:1])
    base = states[3].base.clone()
    base[0] += 2.0
    _, _, (estimate,) = _run(tracker, film.images[4:5], replace(states[3], base=base), replace(memory, appearance=None))
    assert estimate.status == "tracked"  # nothing learned: started afresh
    bare = film.images[0].clone()
    bare[:] = film.images[0][0, 0]
    _, _, (estimate,) = _run(tracker, [bare], replace(states[3], base=base), memory)
    assert estimate.status == "lost"
    assert "0% in the picture" in estimate.reason


def test_a_gate_refuses_what_the_prediction_excludes(film: Any, followed: Any) -> None:
    """A hand that hardly accelerates jumps by 4 px: four deviations of an edge, and the search still reaches it."""
    tracker, _, _, states = followed
    _, memory, _ = _run(tracker, film.images[:1])
    jumped = torch.roll(film.images[3], 4, dims=1)
    still = NoiseSettings(translation=0.01, rotation=0.05)
    loss = LossSettings(min_overlap=0.0, doubt_drop=1.0, doubt_unexplained=1.0)
    found = {}
    for gate in (4.0, 100.0):
        settings = ContourTrackerSettings(gate=gate, edge_std_px=1.0, noise=still, loss=loss, inner_weight=0.0)
        other = ContourTracker(film.kinematics, film.camera, 30.0, settings)
        certain = Gaussian(states[3].belief.mean, 1e-3 * states[3].belief.covariance)
        _, _, (estimate,) = _run(other, [jumped], replace(states[3], belief=certain), memory)
        found[gate] = estimate.found
    assert found[4.0] < 0.6 * found[100.0]


def test_a_skipped_frame_is_no_hand_and_adds_uncertainty(film: Any, followed: Any) -> None:
    tracker, _, estimates, states = followed
    _, memory, _ = _run(tracker, film.images[:1])
    state, estimate = tracker.skip(states[8])
    assert estimate.status == "no_hand"
    _assert_empty(estimate)
    assert state is not None
    added = state.belief.covariance - states[8].belief.covariance
    assert bool((added.diagonal() > 0).all())
    moved = state.belief.mean[:3] - states[8].belief.mean[:3]
    assert float(moved.abs().max()) > 0  # it goes on at the speed it had
    _, _, (after,) = _run(tracker, film.images[10:11], state, memory)
    assert after.status == "tracked"
    assert float((after.keypoints_px - estimates[10].keypoints_px).norm(dim=-1).mean()) < 1.0
    longer, shorter = (torch.einsum("kii->k", one.keypoints_cov) for one in (after, estimates[10]))
    assert bool((longer > shorter).all())


def test_a_track_is_given_up_after_many_skipped_frames(followed: Any) -> None:
    tracker, _, _, states = followed
    state, kept = states[4], []
    for _ in range(tracker.settings.loss.patience):
        state, _ = tracker.skip(state)
        kept.append(state is not None)
    assert kept == [True, True, False]
    assert tracker.skip(None)[0] is None


def test_covariances_are_symmetric_and_positive(followed: Any) -> None:
    _, _, estimates, _ = followed
    for estimate in estimates:
        covariance = estimate.keypoints_cov
        torch.testing.assert_close(covariance, covariance.mT, rtol=0, atol=1e-15)
        assert float(torch.linalg.eigvalsh(covariance).min()) > 0.003**2


def test_a_known_hand_is_certain_of_its_distance(film: Any, followed: Any) -> None:
    shape = film.kinematics.default_shape
    tracker = ContourTracker(film.kinematics, film.camera, 30.0, shape=shape)
    _, memory, (first,) = _run(tracker, film.images[:1])
    assert memory.shape is not None
    assert torch.equal(memory.shape, shape)
    known, fitted = (float(one.keypoints_cov[0, 2, 2]) for one in (first, followed[2][0]))
    length = film.kinematics.shape_space.names.index("hand_length")
    share = float(film.kinematics.shape_space.std[length] / shape[length])
    expected = (share * float(followed[2][0].keypoints[0, 2])) ** 2
    assert fitted - known == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    "settings",
    [
        ContourTrackerSettings(edges_in="grey"),
        ContourTrackerSettings(unscented=UnscentedSettings(variant="paper")),
        # the paper's own: grey levels, the strongest edge, its printed sigma points, constant acceleration, no gate
        ContourTrackerSettings(
            edges_in="grey",
            outer_edges=EdgeSettings(min_strength=0.05),
            inner_edges=EdgeSettings(min_strength=0.05),
            inner_weight=1.0,
            motion=MotionModel(order=2),
            unscented=UnscentedSettings(variant="paper"),
            gate=1e6,
        ),
        ContourTrackerSettings(motion=MotionModel(order=0), noise=NoiseSettings(translation=0.5, rotation=3.0)),
        ContourTrackerSettings(motion=MotionModel(order=1), noise=NoiseSettings(translation=3.0, rotation=15.0)),
        ContourTrackerSettings(inner_weight=0.0, passes=2, pose_space="planar_scale"),
    ],
    ids=["grey", "paper_weights", "paper", "order0", "order1", "scale"],
)
def test_configurations_follow_a_hand_on_black(settings: ContourTrackerSettings, studio: Any) -> None:
    film = studio.film("planar", 10, pace=1.7, look=DARK, seed=4)
    _, _, estimates = _run(ContourTracker(film.kinematics, film.camera, 30.0, settings), film.images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * 10
    assert float(_off_px(estimates, film.keypoints_px).square().mean().sqrt()) < 0.7
    assert float((film.keypoints_px[-1] - film.keypoints_px[0]).norm(dim=-1).mean()) > 3.0


@pytest.mark.parametrize("kind", ["orthographic", "lens"])
def test_other_cameras(kind: str, studio: Any) -> None:
    camera = studio.camera(kind="orthographic" if kind == "orthographic" else "pinhole", lens=kind == "lens")
    film = studio.film("planar", 8, pace=3.0, camera=camera)
    _, _, estimates = _run(ContourTracker(film.kinematics, camera, 30.0), film.images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * 8
    assert float(_off_px(estimates, film.keypoints_px).square().mean().sqrt()) < 0.5
    last = estimates[-1]
    torch.testing.assert_close(camera.project(last.keypoints), last.keypoints_px, rtol=0, atol=1e-9)
    assert float((last.keypoints_px - film.keypoints_px[-1]).norm(dim=-1).mean()) < 3.0
    if kind == "orthographic":  # scale is known, so the only doubt is about joint centres and the filter's own
        assert float(last.keypoints_cov[:, 2, 2].sqrt().max()) < 0.006


def test_fingers_that_move_are_followed(studio: Any) -> None:
    settings = ContourTrackerSettings(
        pose_space="planar_abduction",
        motion=MotionModel(order=0),
        noise=NoiseSettings(translation=0.1, rotation=1.0, angle=3.0),
    )
    film = studio.film("abduction", 22, total=40, camera=studio.camera(240, 192))
    _, _, estimates = _run(ContourTracker(film.kinematics, film.camera, 30.0, settings), film.images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * 22
    little = DOFS.index("little_mcp_aa")
    assert math.degrees(float(estimates[0].pose[little] - estimates[-1].pose[little])) > 4.0
    off = torch.stack([e.keypoints_px for e in estimates]) - film.keypoints_px
    assert float(off[-1].norm(dim=-1).mean()) < 4.0


def test_joint_limits_hold_at_every_frame(studio: Any) -> None:
    settings = ContourTrackerSettings(
        pose_space="dof27",
        motion=MotionModel(order=0),
        noise=NoiseSettings(translation=0.5, rotation=10.0, angle=60.0),  # it may go anywhere
        unscented=UnscentedSettings(alpha=0.33),
    )
    film = studio.film("flexion", 4, total=16)
    tracker = ContourTracker(film.kinematics, film.camera, 30.0, settings)
    _, _, estimates = _run(tracker, film.images)
    skeleton = film.kinematics.skeleton
    poses = torch.stack([e.pose for e in estimates if e.pose is not None])
    assert len(poses) >= 3
    assert bool((poses[:, 6:] >= skeleton.lower - 1e-9).all())
    assert bool((poses[:, 6:] <= skeleton.upper + 1e-9).all())
    assert bool(((poses[:, 6:] - skeleton.lower).abs() < 1e-9).any())  # some joint is at its limit


def test_start_points_are_used_once_and_judged(film: Any, studio: Any) -> None:
    wrist, tip = film.keypoints_px[0, 0].tolist(), film.keypoints_px[0, 12].tolist()
    tracker = ContourTracker(film.kinematics, film.camera, 30.0, start_points=(*wrist, *tip))
    _, _, estimates = _run(tracker, film.images[:2])
    assert [estimate.status for estimate in estimates] == ["tracked"] * 2
    assert float((estimates[1].keypoints_px - film.keypoints_px[1]).norm(dim=-1).mean()) < 3.0
    elsewhere = ContourTracker(film.kinematics, film.camera, 30.0, start_points=(8.0, 60.0, 40.0, 20.0))
    state, memory, (estimate,) = _run(elsewhere, film.images[:1])
    assert estimate.status == "no_hand"
    _assert_empty(estimate)
    assert (state, memory) == (None, Memory())


@pytest.mark.parametrize("rate", [0.0, -30.0, math.nan, math.inf])
def test_a_frame_rate_that_cannot_be(rate: float, film: Any) -> None:
    with pytest.raises(ValueError, match=r"frames_per_second: expected a finite number above 0, got"):
        ContourTracker(film.kinematics, film.camera, rate)


def test_a_picture_of_another_size(film: Any) -> None:
    tracker = ContourTracker(film.kinematics, film.camera, 30.0)
    with pytest.raises(ValueError, match=r"image: expected 200×160 px as the camera says, got 160×200 px"):
        tracker.step(None, Memory(), torch.zeros(200, 160, 3, dtype=torch.uint8))


def test_gradients_flow_after_tracking_in_the_same_process(studio: Any) -> None:
    film = studio.film("planar", 3, total=40, camera=studio.camera(240, 192))
    tracker = ContourTracker(film.kinematics, film.camera, 30.0)
    with torch.inference_mode():  # what is kept for reuse must not be kept as an inference tensor
        state, memory, _ = tracker.step(None, Memory(), film.images[0])
        tracker.step(state, memory, film.images[1])
    pose = torch.zeros(2, 36, dtype=torch.float64)
    pose[:, 2] = 0.5
    pose.requires_grad_()
    shape = film.kinematics.default_shape.clone().requires_grad_()
    projector = HandProjector(film.kinematics, tracker.camera, shape)
    projector.outline_px(pose, torch.eye(3, dtype=torch.float64), tracker.table).sum().backward()
    assert pose.grad is not None
    assert shape.grad is not None
    assert float(pose.grad.abs().sum()) > 0
    assert float(shape.grad.abs().sum()) > 0


@pytest.mark.parametrize(("every", "is_right"), [(2, True), (0, False)])
def test_the_colours_follow_changing_light(studio: Any, every: int, is_right: bool) -> None:
    """The light goes down to a half and turns red within 24 frames: colours of the start alone lose the hand."""
    film = studio.film("planar", 24, look=SceneSettings(supersampling=2, background="plain", noise=2.0))
    dimmed = 1 + torch.linspace(0, 1, 24)[:, None] * (torch.tensor((0.55, 0.4, 0.3)) - 1)
    images = [(image * share).round().to(torch.uint8) for image, share in zip(film.images, dimmed, strict=True)]
    settings = ContourTrackerSettings(light=LightSettings(every=every))
    tracker = ContourTracker(film.kinematics, film.camera, 30.0, settings, shape=film.kinematics.default_shape)
    _, _, estimates = _run(tracker, images)
    assert [estimate.status for estimate in estimates[:12]] == ["tracked"] * 12
    last = estimates[-1]
    assert ((last.overlap or 0.0) > 0.8) == is_right
    if is_right:
        assert float((last.keypoints_px - film.keypoints_px[-1]).norm(dim=-1).mean()) < 2.0


def test_a_correction_that_turns_the_hand_over_must_explain_more(
    film: Any, followed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, memory, _, states = followed
    doubting = LossSettings(doubt_drop=0.0, search_every=1, better_by=0.0, turned_by=0.1)
    tracker = ContourTracker(film.kinematics, film.camera, 30.0, ContourTrackerSettings(loss=doubting))
    memory = replace(memory, overlap=1.0)
    _, _, (own,) = _run(tracker, film.images[1:2], states[0], memory)
    assert own.overlap < 0.98
    for turn, more, takes_over in ((0.1, 0.01, True), (math.pi, 0.01, False), (math.pi, 0.11, True)):
        axis = torch.tensor([0.0, turn, 0.0], dtype=torch.float64)
        turned = replace(states[0], reference=rotation_from_vector(axis) @ states[0].reference)
        found = Estimate(status="recovered", overlap=own.overlap + more)
        monkeypatch.setattr(tracker, "_restart", lambda *_, t=turned, f=found: (t, memory, f))
        state, _, estimate = tracker.step(states[0], memory, film.images[1])
        assert (state is turned) == takes_over
        assert estimate.status == "tracked"
