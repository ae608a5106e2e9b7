"""The tracker on distance maps step by step: followed, lost, recovered, saved and chosen by its configuration."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from tests.steps import FRAME_S, assert_equal, motion_error_px, points_px, right_hand, run, saved_and_restored
from torchhand.errors import InputError
from torchhand.hand import DOFS
from torchhand.numerics import AdaptiveNoiseSettings
from torchhand.runs import settings_of
from torchhand.track import DEFAULTS, Tracker, View
from torchhand.track.extended import ExtendedUpdateSettings
from torchhand.track.unscented import UnscentedUpdateSettings

ABDUCTION = replace(DEFAULTS["distance"], pose_space="planar_abduction", points_per_generator=6, points_per_arc=6)
FULL = replace(ABDUCTION, pose_space="dof26")
ALONE = replace(FULL, learned_posture=False)
"""The update by itself, on pictures of quadrics, of which the network has seen none."""


@pytest.fixture(scope="module")
def film(studio: Any) -> Any:
    """A hand in planar motion, 7 frames."""
    return studio.film("planar", 7, pace=6.0)


@pytest.fixture(scope="module")
def states(film: Any) -> Any:
    """The tracker, and its state and estimate after every frame."""
    tracker, state, found = Tracker(right_hand(), film.camera, ABDUCTION), None, []
    for image in film.images:
        state, (estimate,) = run(tracker, [image], state)
        found.append((state, estimate))
    return tracker, found


@pytest.fixture(scope="module")
def followed(states: Any) -> Any:
    tracker, found = states
    return tracker, found[-1][0], [estimate for _, estimate in found]


def test_a_moving_hand_is_followed(film: Any, followed: Any) -> None:
    *_, estimates = followed
    assert [estimate.status for estimate in estimates] == ["tracked"] * len(film.images)
    truth = film.keypoints_px
    assert float((truth - truth[0]).norm(dim=-1).mean(-1).max()) > 5  # it moves
    assert float(motion_error_px(estimates, truth)[1:].mean()) < 1.0
    assert min(estimate.edges for estimate in estimates) > 0.8
    assert min(estimate.overlap for estimate in estimates) > 0.85


def test_the_filter_learns_rates_and_noise(followed: Any) -> None:
    tracker, state, estimates = followed
    motion, hand = tracker.parts.motion, state.hand
    count = motion.space.size
    assert hand.belief.mean.shape == (2 * count,)  # parameters and velocities
    assert float(hand.belief.mean[count:].abs().max()) > 0.01
    assert hand.density is not None
    nominal, bounds = motion.density, AdaptiveNoiseSettings()
    assert not torch.equal(hand.density, nominal)
    assert bool((hand.density >= bounds.floor * nominal).all() & (hand.density <= bounds.ceiling * nominal).all())
    last = estimates[-1].pose_std
    is_free = torch.tensor([name in motion.space.free_names for name in DOFS])
    assert bool((last[is_free] > 0).all())
    assert not bool(last[~is_free].any())


def test_only_free_parameters_move(followed: Any) -> None:
    tracker, _, estimates = followed
    free = tracker.parts.motion.space.free_names
    frozen = [i for i, name in enumerate(DOFS) if name not in free and not name.startswith("root_r")]
    for estimate in estimates[1:]:
        torch.testing.assert_close(estimate.pose[frozen], estimates[0].pose[frozen], atol=1e-12, rtol=0)


def test_a_saved_state_goes_on_bit_for_bit(film: Any, states: Any) -> None:
    _, found = states
    again = Tracker(right_hand(), film.camera, ABDUCTION)
    _, rest = run(again, film.images[4:], saved_and_restored(found[3][0]))
    for one, (_, other) in zip(rest, found[4:], strict=True):
        assert_equal(one, other)


def test_a_hand_that_vanishes_is_lost_and_recovered(film: Any, followed: Any) -> None:
    tracker, state, _ = followed
    empty = film.images[0][:4, :4].float().mean((0, 1)).to(torch.uint8).expand_as(film.images[0]).contiguous()
    state, gone = run(tracker, [empty] * 3, state)
    assert {estimate.status for estimate in gone} <= {"lost", "no_hand"}
    assert gone[0].status == "lost"
    assert state.hand is None
    assert gone[0].reason
    _, (back,) = run(tracker, film.images[:1], state)
    assert back.status == "recovered"


def test_a_jump_is_caught(studio: Any) -> None:
    """From one picture to the next the hand is elsewhere, turned by 60°, with its index finger bent."""
    before = studio.placed(size=0.5, at=(-0.2, 0.1), angle_deg=-20.0)
    after = studio.placed(size=0.5, at=(0.2, -0.05), angle_deg=40.0)
    bent = torch.tensor([0.6 * (n in ("index_mcp_fe", "index_pip_fe")) + 0.4 * (n == "index_dip_fe") for n in DOFS])
    before, after = (replace(one, pose=one.pose + bent.double()) for one in (before, after))
    start = studio.placed(size=0.5, at=(-0.2, 0.1), angle_deg=-20.0)
    tracker = Tracker(right_hand(), start.camera, ALONE, shape=start.shape)
    images = [one.picture(seed=1) for one in (start, before, before, after, after)]
    _, estimates = run(tracker, images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * len(images)
    assert float((before.keypoints_px - after.keypoints_px).norm(dim=-1).mean()) > 50
    off = (points_px(estimates)[-1] - after.keypoints_px).norm(dim=-1)
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
    _, estimates = run(Tracker(right_hand(), placed.camera, ALONE, shape=placed.shape), images)
    assert [estimate.status for estimate in estimates] == ["tracked"] * len(images)
    truth = replace(placed, pose=poses[-1]).keypoints_px
    assert float((truth - placed.keypoints_px)[[8, 12]].norm(dim=-1).min()) > 8  # the tips move
    off = (points_px(estimates)[-1] - truth).norm(dim=-1)
    assert float(off[[4, 12, 16, 20]].max()) < 4  # tips on the outline; the index finger points at the camera
    assert float(off[[*range(6), *range(9, 21)]].mean()) < 3
    assert (estimates[-1].overlap or 0) > 0.85


def test_limits_hold_at_every_frame_for_tied_angles_too(studio: Any) -> None:
    """A thumb that is bent backwards to its limits: the tied knuckle stops, the root of the thumb goes on."""
    placed = studio.placed(size=0.7)
    skeleton = placed.kinematics.skeleton
    goal = placed.pose.clone()
    for name in ("thumb_cmc_fe", "thumb_mcp_fe", "index_mcp_fe"):
        goal[DOFS.index(name)] = skeleton.lower[DOFS.index(name) - 6]
    images = [replace(placed, pose=torch.lerp(placed.pose, goal, t)).picture(seed=1) for t in (0.0, 0.4, 0.8, 1.0, 1.0)]
    _, estimates = run(Tracker(right_hand(), placed.camera, FULL, shape=placed.shape), images)
    for estimate in estimates:
        assert estimate.status == "tracked"
        assert estimate.pose is not None
        joints = estimate.pose[6:]
        assert bool((joints >= skeleton.lower - 1e-12).all() & (joints <= skeleton.upper + 1e-12).all())


def test_a_followed_hand_is_told_in_another_scene_too(film: Any, followed: Any) -> None:
    """Back from the last frame into the one before, as the smoother does it."""
    tracker, state, estimates = followed
    scene = tracker.scene(state, (View(image=film.images[-2]),), estimates[-2].time_s)
    back = tracker.follow(state, tracker.at_rest(state.hand), scene, -FRAME_S)
    assert back is not None
    off = (points_px([back.estimate])[0] - points_px(estimates)[-2]).norm(dim=-1)
    assert float(off.mean()) < 1.5


def test_the_configuration_chooses_the_update() -> None:
    for name in ("distance_full", "distance_abduction"):
        assert isinstance(settings_of(name).update, ExtendedUpdateSettings)
    assert isinstance(settings_of("contour_full").update, UnscentedUpdateSettings)
    assert settings_of("hull_lm").update is None


@pytest.mark.parametrize("method", ["distances", "[1]"])
def test_a_method_that_is_none(method: str) -> None:
    with pytest.raises(InputError, match="method: expected one of contour, distance, hull, got"):
        settings_of("distance_full", [f"method={method}"])
