"""Parts of drawn hands, and what is refused, with the reason."""

import cv2
import numpy as np
import pytest
import torch

from torchhand.image.finger_order import DIGITS
from torchhand.image.hand_regions import FOREARM_LABEL, PALM_LABEL, HandRegions, NoRegions, divide_hand

# An open hand in palm radii about the palm's centre: where each digit leaves the palm, and the middle of its round end.
BASES = ((-1.36, 0.58), (-0.71, -1.28), (0.0, -1.30), (0.57, -1.11), (1.14, -0.86))
ENDS = ((-2.55, -0.22), (-1.08, -2.75), (0.0, -3.1), (0.86, -2.76), (1.62, -1.95))
WIDTH = 0.44


def drawn(
    *, turn_deg: float = 0.0, mirrored: bool = False, without: tuple[int, ...] = (), palm: float = 40.0
) -> tuple[torch.Tensor, np.ndarray]:
    """Mask of a drawn hand with its arm, thumb on the left unless mirrored, and the tips (5, 2)."""
    side = round(10 * palm)
    canvas = np.zeros((side, side), np.uint8)
    turn = np.deg2rad(turn_deg)
    rotation = np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))))

    def put(x: float, y: float) -> np.ndarray:
        return side / 2 + palm * rotation @ np.array((-x if mirrored else x, y))

    def line(a: np.ndarray, b: np.ndarray, width: float) -> None:
        ends = [tuple(int(v) for v in np.rint(point)) for point in (a, b)]
        cv2.line(canvas, ends[0], ends[1], 1, max(1, round(width * palm)))

    corners = np.array([put(*base) for base in BASES] + [put(0.75, 1.2), put(-0.75, 1.2)])
    cv2.fillPoly(canvas, [cv2.convexHull(np.rint(corners).astype(np.int32))], 1)
    line(put(0, 0), put(0, 3.2), 1.4)
    tips = []
    for number, (base, end) in enumerate(zip(BASES, ENDS, strict=True)):
        along = np.array(end) - base
        along = along / np.hypot(*along)
        tips.append(put(*(np.array(end) + 0.5 * WIDTH * along)))
        if number not in without:
            line(put(*(np.array(base) - 0.3 * along)), put(*end), WIDTH)
    return torch.from_numpy(canvas > 0), np.array(tips)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("turn_deg", [0.0, 140.0, -65.0])
def test_digits_webs_wrist_and_labels(turn_deg: float, mirrored: bool) -> None:
    mask, tips = drawn(turn_deg=turn_deg, mirrored=mirrored)
    regions = divide_hand(mask)
    assert isinstance(regions, HandRegions)
    assert regions.is_mirrored == mirrored
    assert tuple(digit.name for digit in regions.digits) == DIGITS
    turn = np.deg2rad(turn_deg)
    rotation = np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))))
    for number, (digit, tip) in enumerate(zip(regions.digits, tips, strict=True)):
        along = (np.array(ENDS[number]) - BASES[number]) * ((-1, 1) if mirrored else (1, 1))
        along = rotation @ along / np.hypot(*along)
        assert digit.direction @ along > np.cos(np.deg2rad(2.5))
        assert np.hypot(*(digit.tip - tip)) < 1.5
        assert digit.radius == pytest.approx(9.5, abs=0.6)  # OpenCV draws lines a pixel wider
        x, y = np.rint(digit.tip - 6 * along).astype(int)
        assert int(regions.labels[y, x]) == number + 1
    up = rotation @ (0.0, -1.0)
    assert regions.axis @ up > np.cos(np.deg2rad(8))
    assert -2.2 < (regions.wrist - 200) @ up / 40 < -0.9
    assert int(regions.labels[200, 200]) == PALM_LABEL
    x, y = np.rint(200 - 2.8 * 40 * up).astype(int)
    assert int(regions.labels[y, x]) == FOREARM_LABEL
    assert bool(((regions.labels > 0) == mask).all())
    between = [0.5 * (np.array(BASES[i]) + BASES[i + 1]) * ((-1, 1) if mirrored else (1, 1)) for i in range(1, 4)]
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
def test_fewer_than_five_are_named(without: tuple[int, ...], count: int) -> None:
    found = divide_hand(drawn(without=without)[0])
    assert isinstance(found, NoRegions)
    assert len(found.found) == count
    assert found.reason.startswith("only ")
    assert all(name in found.reason for name in DIGITS)


def test_two_hands_apart_and_joined() -> None:
    wide = torch.cat((drawn()[0], drawn(mirrored=True)[0]), 1)
    assert "two hands" in reason(wide)
    wide[305:325, 190:610] = True
    assert "two hands" in reason(wide)


def test_digit_cut_by_the_picture() -> None:
    whole, _ = drawn()
    rows = whole.any(1).nonzero()[:, 0]
    cut = whole[int(rows[0]) + 25 :]
    assert "picture's edge cuts" in reason(cut)
    assert "middle" in reason(cut)


def test_specks_and_holes_do_not_matter() -> None:
    mask, _ = drawn()
    mask[5:8, 5:8] = True
    mask[195:205, 195:205] = False
    regions = divide_hand(mask)
    assert isinstance(regions, HandRegions)
    assert bool(regions.mask[200, 200])
    assert not bool(regions.mask[6, 6])
