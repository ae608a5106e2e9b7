"""Proportions over frames of a recording: which frames, what they tell, and hands of another shape in their place."""

import itertools
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.studio import StagedHand, Studio
from torchhand.files import load_hand_model
from torchhand.fit import Stage
from torchhand.hand import DOFS, HandKinematics, HandPose
from torchhand.runs import settings_of
from torchhand.track import (
    FollowedFrame,
    Tracker,
    TrackerState,
    View,
    can_tell_shape,
    frames_for_shape,
    recorded_shape,
    reshaped_poses,
)
from torchhand.track.shape import spread_frames
from torchhand.track.unscented import UnscentedUpdate

POSTURES = ("open", "point", "flat", "open")
WIDTH, HEIGHT = 240, 192


def tracker_of(studio: Studio, config: str = "contour_full", shape: Tensor | None = None) -> Tracker:
    settings = replace(settings_of(config), learned_posture=False, learned_proposals=False)
    hand = load_hand_model().hand(side="right", dtype=torch.float64)
    return Tracker(hand, studio.camera(WIDTH, HEIGHT), settings, shape=shape)


def whole_vector(hand: StagedHand) -> Tensor:
    """The pose with the root's whole rotation vector."""
    return HandPose.of(hand.pose, hand.root_reference).vector


@pytest.fixture(scope="module")
def kinematics(studio: Studio) -> HandKinematics:
    return studio.kinematics()


@pytest.fixture(scope="module")
def person(kinematics: HandKinematics) -> Tensor:
    """A hand broader than most for its length, with thicker fingers."""
    space = kinematics.shape_space
    is_breadth = torch.tensor([name == "hand_breadth" for name in space.names])
    return space.default + torch.where(is_breadth, 1.5 * space.std, 0.0)


# ---------------------------------------------------------------------------------------- which frames


def test_chosen_frames_are_good_and_differ_more_than_any_other_choice_one_by_one() -> None:
    generator = torch.Generator().manual_seed(2)
    whole = 0.1 * torch.randn(40, 36, generator=generator, dtype=torch.float64)
    whole[20:30, 6:] += 2.0  # another posture
    whole[30:, 5] += 1.5  # another direction
    is_good = torch.ones(40, dtype=torch.bool)
    is_good[::3] = False
    whole[0] = torch.nan  # a frame without a hand
    rows = spread_frames(whole, is_good, 6)
    assert rows == sorted(set(rows))
    assert all(bool(is_good[row]) for row in rows)
    assert {1} <= set(rows)
    assert {row // 10 for row in rows} >= {0, 2, 3}
    assert len(spread_frames(whole, is_good, 100)) == int(is_good.sum())
    assert spread_frames(whole, torch.zeros_like(is_good), 6) == []


def test_frames_in_which_the_hand_is_followed_badly_tell_no_proportions() -> None:
    poses = torch.arange(6.0, dtype=torch.float64)[:, None].expand(6, 36) * 0.1
    overlap = torch.tensor([0.9, 0.7, torch.nan, 0.8, 0.95, torch.nan], dtype=torch.float64)
    assert frames_for_shape(poses, overlap, 6) == [0, 4]  # half of four
    assert frames_for_shape(poses, torch.full_like(overlap, torch.nan), 6) == []


def test_frames_of_a_hand_that_rests_are_spread_over_time() -> None:
    rows = spread_frames(torch.zeros(31, 36, dtype=torch.float64), torch.ones(31, dtype=torch.bool), 4)
    assert rows[0] == 0
    assert rows[-1] == 30
    assert max(b - a for a, b in itertools.pairwise(rows)) <= 15


# ---------------------------------------------------------------------------------------- what they tell


def frames_of(studio: Studio, shape: Tensor) -> list[FollowedFrame]:
    """A hand of a shape in several postures, which were followed to some degrees and millimetres."""
    generator, found = torch.Generator().manual_seed(4), []
    for index, posed in enumerate(POSTURES):
        camera = studio.camera(WIDTH, HEIGHT)
        hand = studio.placed(view="back", posed=posed, shape=shape, angle_deg=8.0 * index, size=0.7, camera=camera)
        followed = whole_vector(hand)
        followed[6:] += 0.03 * torch.randn(30, generator=generator, dtype=torch.float64)
        found.append(FollowedFrame(views=(View(mask=hand.mask),), time_s=index / 30, pose=followed))
    return found


@pytest.mark.slow
def test_frames_that_are_independent_tell_the_proportions_of_the_person(
    studio: Studio, kinematics: HandKinematics, person: Tensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(UnscentedUpdate, "overconfidence", 1.0)  # simulated pictures have no errors in common
    monkeypatch.setattr("torchhand.track.shape.SCHEDULE", (Stage(gross_m=0.0075, rounds=1, iterations=3),))
    space, before = kinematics.shape_space, kinematics.default_shape
    found = recorded_shape(tracker_of(studio), TrackerState(shape=before), frames_of(studio, person))
    assert found is not None
    assert float(found.costs.mean()) < float(found.costs_before.mean())
    assert not found.is_contradicted
    length = space.names.index("hand_length")
    is_radius = torch.tensor([name.endswith(("pip_radius", "dip_radius")) for name in space.names])
    thickness, expected, default = (space.metres(one)[is_radius].mean() for one in (found.shape, person, before))
    assert abs(thickness - expected) < 0.7 * abs(default - expected)
    assert found.shape[length] == before[length]  # one camera cannot tell it
    assert found.shape_std[length] == 0
    others = torch.arange(len(before)) != length
    assert bool((found.shape_std[others] > 0).all())
    assert bool((torch.linalg.eigvalsh(found.keypoints_cov) > -1e-12).all())


def test_errors_that_all_frames_share_leave_proportions_less_sure(
    studio: Studio, kinematics: HandKinematics, person: Tensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Standard deviations of a rule sixteen times as overconfident are larger, and none larger than people's."""
    monkeypatch.setattr("torchhand.track.shape.SCHEDULE", (Stage(gross_m=0.0075, rounds=1, iterations=1),))
    frames, found = frames_of(studio, person), []
    for factor in (1.0, 16.0):
        monkeypatch.setattr(UnscentedUpdate, "overconfidence", factor)
        own = recorded_shape(tracker_of(studio), TrackerState(shape=kinematics.default_shape), frames)
        assert own is not None
        found.append(own)
    sure, unsure = found
    is_free = sure.shape_std > 0
    ratio = (unsure.shape_std / sure.shape_std)[is_free]
    assert bool(((ratio > 0.99) & (ratio < 16.0)).all())
    assert float(ratio.median()) > 1.2
    space = kinematics.shape_space
    assert float((unsure.shape_std / space.std)[is_free].max()) < 1.01  # no less sure than of anybody's hand


def test_too_few_frames_tell_nothing(studio: Studio, kinematics: HandKinematics) -> None:
    state, frames = TrackerState(shape=kinematics.default_shape), frames_of(studio, kinematics.default_shape)
    empty = replace(frames[0], views=(View(mask=torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)),))
    assert recorded_shape(tracker_of(studio), state, [*frames[:2], empty, frames[3]]) is None
    assert recorded_shape(tracker_of(studio), state, []) is None


def test_given_proportions_and_stiff_fingers_are_not_fitted(studio: Studio, person: Tensor) -> None:
    assert can_tell_shape(tracker_of(studio))
    assert not can_tell_shape(tracker_of(studio, shape=person))
    assert not can_tell_shape(tracker_of(studio, "contour_planar"))


# ---------------------------------------------------------------------------------------- hands of another shape


def test_a_hand_of_another_shape_lies_where_the_first_one_did_and_bends_as_it_did(
    studio: Studio, kinematics: HandKinematics, person: Tensor
) -> None:
    motion, default = tracker_of(studio).parts.motion, kinematics.default_shape
    poses = torch.stack([whole_vector(studio.placed(posed=posed, angle_deg=50.0)) for posed in ("open", "point")])
    moved = reshaped_poses(poses, motion, kinematics, default, person)
    target = kinematics(poses, default).keypoints

    def missed(some: Tensor) -> Tensor:
        return (kinematics(some, person).keypoints - target).square().sum((-2, -1)).sqrt()

    assert bool((missed(moved) < 0.8 * missed(poses)).all())
    free = torch.tensor([name in motion.space.free_names for name in DOFS])
    assert float((moved - poses)[:, free][:, 6:].abs().max()) < 0.1  # radians
    assert float((moved - poses)[:, ~free].abs().max()) < 1e-3
    for pose, alone in zip(poses, moved, strict=True):
        single = reshaped_poses(pose[None], motion, kinematics, default, person)
        torch.testing.assert_close(single[0], alone, rtol=0, atol=1e-9)


def test_a_hand_of_the_same_shape_stays(studio: Studio, kinematics: HandKinematics) -> None:
    pose, shape = whole_vector(studio.placed(angle_deg=-120.0))[None], kinematics.default_shape
    same = reshaped_poses(pose, tracker_of(studio).parts.motion, kinematics, shape, shape)
    torch.testing.assert_close(same, pose, rtol=0, atol=1e-9)
