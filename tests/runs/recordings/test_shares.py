"""Shares of a pass: every frame is told of once, after a run-in from where the hand is explained well."""

import numpy as np
import pytest

from torchhand.runs.recordings.shares import RUN_IN, shares_of


@pytest.mark.parametrize("is_backward", [True, False])
@pytest.mark.parametrize("frames", [1, 60, 199, 399, 621, 2000, 20000])
def test_every_wanted_frame_is_told_of_once(frames: int, is_backward: bool) -> None:
    generator = np.random.default_rng(frames)
    is_wanted = generator.random(frames) > 0.1
    is_wanted[0] = True
    found = shares_of(generator.random(frames), is_wanted, is_backward=is_backward)
    told = [place for one in found for place in one.told]
    assert told == list(range(np.flatnonzero(is_wanted)[-1] + 1))
    assert len(found) == {1: 1, 60: 1, 199: 1, 399: 2, 621: 4, 2000: 8, 20000: 16}[frames]
    for place, one in enumerate(found):
        assert set(one.told) <= set(one.followed)
        is_first = place == (len(found) - 1 if is_backward else 0)  # in the order of its pass
        assert len(one.followed) - len(one.told) == (0 if is_first else RUN_IN)


@pytest.mark.parametrize("is_backward", [True, False])
def test_a_share_begins_where_the_hand_is_explained_best(is_backward: bool) -> None:
    overlap = np.full(220, 0.8)
    overlap[[85, 111, 135]] = 0.9, 0.95, 0.99  # the last one is too far from the middle
    first, second = shares_of(overlap, np.ones(220, dtype=bool), is_backward=is_backward)
    assert (first.followed.stop - 1 if is_backward else second.followed.start) == 111 - is_backward


def test_a_share_begins_after_frames_that_are_not_wanted_where_there_are_some() -> None:
    is_wanted = np.ones(220, dtype=bool)
    is_wanted[95:99] = False
    overlap = np.linspace(0.5, 0.9, 220)
    assert shares_of(overlap, is_wanted, is_backward=False)[1].followed.start == 95


def test_a_pass_is_not_cut_where_no_hand_is_followed() -> None:
    overlap = np.full(300, 0.8)
    overlap[70:250] = np.nan
    (share,) = shares_of(overlap, np.ones(300, dtype=bool), is_backward=True)
    assert share.told == share.followed == range(300)
