"""Where an arm's silhouette ends, and models that lie on the arm in the hand's place."""

import pytest
import torch
from torch import Tensor

from torchhand.track.scene.arm_end import hand_end, is_on_arm, lengths_to_end

HEIGHT, WIDTH = 200, 120
LENGTH = 60.0  # of a hand, px


def _bar(top: int, bottom: int = HEIGHT, left: int = 50, right: int = 70) -> Tensor:
    mask = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    mask[top:bottom, left:right] = True
    return mask


def _is_on_arm(picture: Tensor, model: Tensor) -> bool:
    y, x = model.nonzero().double().mean(0).tolist()
    return is_on_arm(picture, model, torch.tensor((x, y), dtype=torch.float64), LENGTH)


def test_a_model_at_the_border_is_on_the_arm_that_ends_elsewhere() -> None:
    model = _bar(160)
    assert _is_on_arm(_bar(20), model)
    assert _is_on_arm(_bar(0, 180), _bar(0, 40))  # from above
    assert not _is_on_arm(_bar(120), model)  # all of it is within a hand's length


def test_the_hand_at_the_end_of_the_arm_is_none_on_it() -> None:
    assert not _is_on_arm(_bar(20), _bar(20, 70))


@pytest.mark.parametrize("other", [_bar(0), _bar(20) | _bar(20, 40, left=50, right=WIDTH)], ids=["above", "beside"])
def test_where_an_arm_leaves_the_picture_twice_the_hand_may_be_at_either_border(other: Tensor) -> None:
    assert not _is_on_arm(other, _bar(160))


def test_a_model_that_is_not_at_the_border_is_left_to_others() -> None:
    assert not _is_on_arm(_bar(20), _bar(130, 190))


def test_lengths_are_measured_through_the_silhouette() -> None:
    bent = _bar(20) | _bar(20, 40, left=50, right=110)
    lengths = lengths_to_end(bent)
    assert lengths is not None
    assert lengths.shape == (HEIGHT, WIDTH)
    assert float(lengths[30, 108]) < 3
    assert float(lengths[195, 60]) > 190  # round the corner
    assert lengths_to_end(_bar(20, 150)) is None


def _arm(*, left: int, right: int) -> Tensor:
    """A bar 20 px broad and a knob 30 px broad at its right end, in a picture of 240 x 120 px."""
    mask = torch.zeros(120, 240, dtype=torch.bool)
    mask[50:70, left:right] = True
    mask[45:75, right - 30 : right] = True
    return mask


def test_an_arm_ends_where_it_does_not_leave_the_picture() -> None:
    mask = _arm(left=0, right=200)
    end = hand_end(mask, LENGTH)
    assert not bool((end & ~mask).any())
    assert bool(end[60, 199])
    assert not bool(end[:, :90].any())
    assert int((hand_end(mask.flip(1), LENGTH).flip(1) ^ end).sum()) < 0.02 * int(mask.sum())


def test_one_that_a_sleeve_ends_comes_from_the_nearer_border() -> None:
    end = hand_end(_arm(left=8, right=190), LENGTH)
    assert bool(end[60, 189])
    assert not bool(end[:, :60].any())


@pytest.mark.parametrize("mask", [_arm(left=0, right=85), _arm(left=100, right=210), torch.zeros(120, 240) > 0])
def test_a_hand_with_some_of_its_forearm_is_whole(mask: Tensor) -> None:
    assert torch.equal(hand_end(mask, LENGTH), mask)


def test_large_pictures_are_cut_as_their_copies() -> None:
    mask = _arm(left=0, right=200)
    large = mask.repeat_interleave(3, 0).repeat_interleave(3, 1)
    end = hand_end(large, 3 * LENGTH)
    assert end.shape == large.shape
    assert int((end[1::3, 1::3] ^ hand_end(mask, LENGTH)).sum()) < 0.02 * int(mask.sum())
