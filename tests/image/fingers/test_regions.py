"""Parts of drawn hands, and what is refused, with the reason."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from torchhand.image.fingers.order import DIGITS
from torchhand.image.fingers.regions import HandRegions, NoRegions, divide_hand

Drawn = Callable[..., tuple[torch.Tensor, np.ndarray]]
Plan = tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("turn_deg", [0.0, 140.0, -65.0])
def test_digits_webs_and_wrist(drawn: Drawn, plan: Plan, turn_deg: float, mirrored: bool) -> None:
    bases, ends = plan
    mask, tips = drawn(turn_deg=turn_deg, mirrored=mirrored)
    regions = divide_hand(mask)
    assert isinstance(regions, HandRegions)
    assert regions.is_mirrored == mirrored
    assert tuple(digit.name for digit in regions.digits) == DIGITS
    turn = np.deg2rad(turn_deg)
    rotation = np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))))
    for number, (digit, tip) in enumerate(zip(regions.digits, tips, strict=True)):
        along = (np.array(ends[number]) - bases[number]) * ((-1, 1) if mirrored else (1, 1))
        along = rotation @ along / np.hypot(*along)
        assert digit.direction @ along > np.cos(np.deg2rad(2.5))
        assert np.hypot(*(digit.tip - tip)) < 1.5
        assert digit.radius == pytest.approx(9.5, abs=0.6)  # OpenCV draws lines a pixel wider
    up = rotation @ (0.0, -1.0)
    assert regions.axis @ up > np.cos(np.deg2rad(8))
    assert -2.2 < (regions.wrist - 200) @ up / 40 < -0.9
    between = [0.5 * (np.array(bases[i]) + bases[i + 1]) * ((-1, 1) if mirrored else (1, 1)) for i in range(1, 4)]
    for web, place in zip(regions.webs[1:], between, strict=True):
        assert np.hypot(*(web - 200 - 40 * rotation @ place)) < 10.0


def reason(mask: torch.Tensor) -> str:
    found = divide_hand(mask)
    assert isinstance(found, NoRegions)
    return found.reason


def test_almost_empty() -> None:
    mask = torch.zeros(100, 100, dtype=torch.bool)
    assert "almost empty (0 px" in reason(mask)
    mask[:5, :5] = True
    assert "almost empty (25 px" in reason(mask)


def test_no_fingers() -> None:
    mask = torch.zeros(200, 200, dtype=torch.bool)
    mask[40:160, 50:150] = True
    assert "no open hand" in reason(mask)


@pytest.mark.parametrize(("without", "count"), [((0,), 4), ((3,), 4), ((3, 4), 3)])
def test_fewer_than_five_are_named(drawn: Drawn, without: tuple[int, ...], count: int) -> None:
    found = divide_hand(drawn(without=without)[0])
    assert isinstance(found, NoRegions)
    assert len(found.found) == count
    assert found.reason.startswith("only ")
    assert all(name in found.reason for name in DIGITS)


def test_two_hands_apart_and_joined(drawn: Drawn) -> None:
    wide = torch.cat((drawn()[0], drawn(mirrored=True)[0]), 1)
    assert "two hands" in reason(wide)
    wide[305:325, 190:610] = True
    assert "two hands" in reason(wide)


def test_digit_cut_by_the_picture(drawn: Drawn) -> None:
    whole, _ = drawn()
    rows = whole.any(1).nonzero()[:, 0]
    cut = whole[int(rows[0]) + 25 :]
    assert "picture's edge cuts" in reason(cut)
    assert "middle" in reason(cut)


def test_specks_and_holes_do_not_matter(drawn: Drawn) -> None:
    mask, _ = drawn()
    mask[5:8, 5:8] = True
    mask[195:205, 195:205] = False
    regions = divide_hand(mask)
    assert isinstance(regions, HandRegions)
    assert bool(regions.mask[200, 200])
    assert not bool(regions.mask[6, 6])
