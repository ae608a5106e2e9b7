"""The distance-map tracker step by step: followed, lost, recovered, saved and chosen by its configuration."""

import io
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.cli.request import settings_of
from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.hand import DOFS
from torchhand.track.contour_tracker import ContourTracker
from torchhand.track.distance_settings import DistanceTrackerSettings
from torchhand.track.distance_tracker import DistanceTracker
from torchhand.track.state import Estimate, Memory
from torchhand.track.trackers import tracker_of

ABDUCTION = DistanceTrackerSettings(pose_space="planar_abduction", points_per_generator=6, points_per_arc=6)
FULL = replace(ABDUCTION, pose_space="dof26")


def _run(tracker: Any, images: Sequence[Tensor], state: Any = None, memory: Memory | None = None) -> Any:
    memory, estimates = memory or Memory(), []
    with torch.no_grad():
        for image in images:
            state, memory, estimate = tracker.step(state, memory, image)
            estimates.append(estimate)
    return state, memory, estimates


def _assert_equal(one: Estimate, other: Estimate) -> None:
    for field in fields(Estimate):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert torch.equal(a, b) if isinstance(a, Tensor) else a == b, field.name


@pytest.fixture(scope="module")
def film(studio: Any) -> Any:
    """A hand in planar motion, 7 frames."""
    return studio.film("planar", 7, pace=6.0)


@pytest.fixture(scope="module")
def followed(film: Any) -> Any:
    tracker = DistanceTracker(film.kinematics, film.camera, 30.0, ABDUCTION)
    return tracker, *_run(tracker, film.images)


def test_a_moving_hand_is_followed(film: Any, followed: Any) -> None:
    *_, estimates = followed
    assert [estimate.status for estimate in estimates] == ["tracked"] * len(film.images)
    points = torch.stack([estimate.keypoints_px for estimate in estimates])
    truth = film.keypoints_px
    off = ((points - points[0]) - (truth - truth[0])).norm(dim=-1).mean(-1)
    assert float((truth - truth[0]).norm(dim=-1).mean(-1).max()) > 5  # it moves
    assert float(off[1:].mean()) < 1.0
    assert min(estimate.found for estimate in estimates) > 0.8
    assert min(estimate.overlap for estimate in estimates) > 0.85


def test_the_filter_learns_rates_and_noise(followed: Any) -> None:
    tracker, state, _, estimates = followed
    count = tracker.space.size
    assert state.belief.mean.shape == (2 * count,)  # parameters and velocities
    assert float(state.belief.mean[count:].abs().max()) > 0.01
    assert state.density is not None
    nominal = tracker._density
    assert not torch.equal(state.density, nominal)
    bounds = ABDUCTION.adaptive
    assert bool((state.density >= bounds.floor * nominal).all() & (state.density <= bounds.ceiling * nominal).all())
    last = estimates[-1].pose_std
    is_free = torch.tensor([name in tracker.space.free_names for name in DOFS])
    assert bool((last[is_free] > 0).all())
    assert not bool(last[~is_free].any())


def test_only_free_parameters_move(followed: Any) -> None:
    tracker, _, _, estimates = followed
    held = [i for i, name in enumerate(DOFS) if name not in tracker.space.free_names and not name.startswith("root_r")]
    for estimate in estimates[1:]:
        torch.testing.assert_close(estimate.pose[held], estimates[0].pose[held], atol=1e-12, rtol=0)


def test_a_saved_state_goes_on_bit_for_bit(film: Any, followed: Any) -> None:
    tracker, _, _, estimates = followed
    state, memory, _ = _run(tracker, film.images[:4])
    file = io.BytesIO()
    torch.save(tracker.state_dict(state, memory), file)
    file.seek(0)
    again = DistanceTracker(film.kinematics, film.camera, 30.0, ABDUCTION)
    *_, rest = _run(again, film.images[4:], *again.restore(torch.load(file, weights_only=True)))
    for one, other in zip(rest, estimates[4:], strict=True):
        _assert_equal(one, other)


def test_a_hand_that_vanishes_is_lost_and_recovered(film: Any, followed: Any) -> None:
    tracker, state, memory, _ = followed
    empty = film.images[0][:4, :4].float().mean((0, 1)).to(torch.uint8).expand_as(film.images[0]).contiguous()
    state, memory, gone = _run(tracker, [empty] * 2, state, memory)
    assert [estimate.status for estimate in gone] in (["lost", "lost"], ["lost", "no_hand"])
    assert state is None
    assert gone[0].reason
    *_, (back,) = _run(tracker, film.images[:1], state, memory)
    assert back.status == "recovered"


def test_a_jump_is_caught(studio: Any) -> None:
    """From one picture to the next the hand is elsewhere, turned by 60°, with its index finger bent."""
    before = studio.placed(size=0.5, at=(-0.2, 0.1), angle_deg=-20.0)
    after = studio.placed(size=0.5, at=(0.2, -0.05), angle_deg=40.0)
    bent = torch.tensor([0.6 * (n in ("index_mcp_fe", "index_pip_fe")) + 0.4 * (n == "index_dip_fe") for n in DOFS])
    before, after = (replace(one, pose=one.pose + bent.double()) for one in (before, after))
    start = studio.placed(size=0.5, at=(-0.2, 0.1), angle_deg=-20.0)
    tracker = DistanceTracker(start.kinematics, start.camera, 30.0, FULL, shape=start.shape)
    images = [one.picture(seed=1) for one in (start, before, before, after, after)]
    *_, estimates = _run(tracker, images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * len(images)
    assert float((before.keypoints_px - after.keypoints_px).norm(dim=-1).mean()) > 50
    off = (estimates[-1].keypoints_px - after.keypoints_px).norm(dim=-1)
    assert float(off.mean()) < 2.5
    assert float(off.max()) < 8


def test_fingers_that_bend_are_followed(studio: Any) -> None:
    """Pictures of a known hand whose index and middle finger bend."""
    placed = studio.placed(size=0.7)
    bend = torch.tensor([float(n in ("index_mcp_fe", "index_pip_fe", "middle_mcp_fe")) for n in DOFS]).double()
    dip = torch.tensor([float(n == "index_dip_fe") for n in DOFS]).double()
    angles = torch.linspace(0, 0.8, 7, dtype=torch.float64)
    poses = [placed.pose + angle * (bend + dip * 2 / 3) for angle in angles]
    images = [replace(placed, pose=pose).picture(seed=1) for pose in poses]
    tracker = DistanceTracker(placed.kinematics, placed.camera, 30.0, FULL, shape=placed.shape)
    *_, estimates = _run(tracker, images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * len(images)
    truth = replace(placed, pose=poses[-1]).keypoints_px
    assert float((truth - placed.keypoints_px)[[8, 12]].norm(dim=-1).min()) > 8  # the tips move
    off = (estimates[-1].keypoints_px - truth).norm(dim=-1)
    assert float(off[[4, 12, 16, 20]].max()) < 4  # tips on the outline; the index finger points at the camera
    assert float(off[[*range(6), *range(9, 21)]].mean()) < 3
    assert estimates[-1].overlap > 0.85


def test_limits_hold_at_every_frame_for_tied_angles_too(studio: Any) -> None:
    """A thumb that is bent backwards to its limits: the tied knuckle stops, the root of the thumb goes on."""
    placed = studio.placed(size=0.7)
    skeleton = placed.kinematics.skeleton
    goal = placed.pose.clone()
    for name in ("thumb_cmc_fe", "thumb_mcp_fe", "index_mcp_fe"):
        goal[DOFS.index(name)] = skeleton.lower[DOFS.index(name) - 6]
    images = [replace(placed, pose=torch.lerp(placed.pose, goal, t)).picture(seed=1) for t in (0.0, 0.4, 0.8, 1.0, 1.0)]
    tracker = DistanceTracker(placed.kinematics, placed.camera, 30.0, FULL, shape=placed.shape)
    *_, estimates = _run(tracker, images)
    for estimate in estimates:
        assert estimate.status == "tracked"
        joints = estimate.pose[6:]
        assert bool((joints >= skeleton.lower - 1e-12).all() & (joints <= skeleton.upper + 1e-12).all())


def test_the_skin_that_is_registered_is_that_of_the_hand_given(studio: Any) -> None:
    """A model whose skin is a tenth larger about its own bones has contours a tenth wider, and is followed by them."""
    placed, settings = studio.placed(size=0.7), replace(FULL, surface="mesh")
    model = load_hand_model()
    assert model.mesh is not None
    middle = model.mesh.vertices.mean(0)
    larger = replace(model, mesh=replace(model.mesh, vertices=middle + 1.1 * (model.mesh.vertices - middle)))
    widths = []
    for own, dtype in ((model, torch.float64), (larger, torch.float64), (model, torch.float32)):
        hand = own.hand(side=placed.kinematics.side, dtype=dtype)
        tracker = DistanceTracker(hand, placed.camera, 30.0, settings, shape=placed.shape)
        look = tracker._contours_of(placed.shape).look(placed.pose[None], placed.root_reference[None], beyond_px=2.0)
        points = look.points_px[0, (look.outer | look.inner)[0]]
        widths.append(float((points.amax(0) - points.amin(0)).norm()))
    assert widths[1] == pytest.approx(1.1 * widths[0], rel=0.01)
    assert widths[2] == pytest.approx(widths[0], rel=1e-5)
    with pytest.raises(ValueError, match="surface: 'mesh' needs a Hand, whose skin is registered, got HandKinematics"):
        DistanceTracker(placed.kinematics, placed.camera, 30.0, settings)


def test_a_hand_and_its_bones_alone_are_followed_alike(film: Any, followed: Any) -> None:
    hand = load_hand_model().hand(dtype=torch.float64)
    assert film.kinematics.side == hand.side
    *_, estimates = _run(DistanceTracker(hand, film.camera, 30.0, ABDUCTION), film.images[:3])
    for one, other in zip(estimates, followed[-1], strict=False):
        _assert_equal(one, other)


def test_the_configuration_chooses_the_tracker(film: Any) -> None:
    for name, kind in (("distance_full", DistanceTracker), ("distance_abduction", DistanceTracker)):
        settings = settings_of(name)
        assert type(tracker_of(film.kinematics, film.camera, 30.0, settings)) is kind
    contour = settings_of("contour_full")
    assert type(tracker_of(film.kinematics, film.camera, 30.0, contour)) is ContourTracker


@pytest.mark.parametrize("method", ["distances", "[1]"])
def test_a_method_that_is_none(method: str) -> None:
    with pytest.raises(InputError, match="--set: method: expected one of contour, distance, got"):
        settings_of("distance_full", [f"method={method}"])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"postures": ("open", "wave")}, "postures: expected names among .*, got 'wave'"),
        ({"bad_share": 0.0}, "bad_share: expected above 0 and finite, got 0.0"),
        ({"pose_weight": -1.0}, "pose_weight: expected 0 or more and finite, got -1.0"),
        ({"sudden": 0.5}, "sudden: expected 1 or more and finite, got 0.5"),
        ({"sudden_share": 1.5}, "sudden_share: expected 0 to 1, got 1.5"),
        ({"pose_space": "dof99"}, "pose_space: expected one of"),
    ],
)
def test_settings_are_checked(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DistanceTrackerSettings(**values)
