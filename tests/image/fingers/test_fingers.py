"""Fingers of drawn hands: found at any angle and size, named, and taken apart where they meet."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from torchhand.image.fingers.fingers import FingerSettings, find_fingers, opened_by_disc
from torchhand.image.fingers.order import DIGITS, order_fingers

Drawn = Callable[..., tuple[torch.Tensor, np.ndarray]]


@pytest.mark.parametrize("turn_deg", [0.0, 77.0, 180.0, -130.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_five_fingers_at_any_angle_of_either_hand(drawn: Drawn, turn_deg: float, mirrored: bool) -> None:
    mask, tips = drawn(turn_deg=turn_deg, mirrored=mirrored)
    found = find_fingers(mask)
    assert found.order is not None
    assert tuple(found.order.fingers) == DIGITS
    assert found.order.is_mirrored == mirrored
    for (name, number), tip in zip(found.order.fingers.items(), tips, strict=True):
        assert np.hypot(*(np.array(found.pieces[number].tip) - tip)) < 4.0, name


@pytest.mark.parametrize("palm_px", [14.0, 30.0, 120.0])
def test_disc_finds_its_own_size(drawn: Drawn, palm_px: float) -> None:
    found = find_fingers(drawn(palm=palm_px, turn_deg=25.0)[0])
    assert found.order is not None
    assert len(found.order.fingers) == 5
    assert 0.18 * palm_px < found.disc_radius < 0.65 * palm_px
    assert found.palm_radius == pytest.approx(palm_px, rel=0.15)


@pytest.mark.parametrize("missing", [(0,), (3,), (1, 4)])
def test_fewer_fingers_are_counted(drawn: Drawn, missing: tuple[int, ...]) -> None:
    found = find_fingers(drawn(without=missing, turn_deg=-30.0)[0])
    assert found.order is not None
    assert len(found.order.fingers) == 5 - len(missing)


def test_fingers_that_meet_at_the_web_are_taken_apart(drawn: Drawn) -> None:
    mask, tips = drawn(palm=40.0)
    web = np.zeros(mask.shape, np.uint8)
    corners = np.array((tips[2], tips[3], (200.0, 200.0)))
    corners[:2] = 0.55 * corners[:2] + 0.45 * corners[2]
    cv2.fillPoly(web, [np.rint(corners).astype(np.int32)], 1)
    found = find_fingers(mask | torch.from_numpy(web > 0))
    assert found.order is not None
    assert tuple(found.order.fingers) == DIGITS


@pytest.mark.parametrize("shape", ["disc", "bar", "empty"])
def test_no_hand_has_no_order(shape: str) -> None:
    canvas = np.zeros((200, 200), np.uint8)
    if shape == "disc":
        cv2.circle(canvas, (100, 100), 60, 1, -1)
    if shape == "bar":
        cv2.rectangle(canvas, (10, 80), (190, 120), 1, -1)
    assert find_fingers(torch.from_numpy(canvas > 0)).order is None


def test_opening_is_that_of_the_definition(generator: torch.Generator) -> None:
    mask = torch.rand(24, 30, generator=generator) > 0.12
    radius = 2.3
    rows, columns = np.mgrid[:24, :30]
    padded = np.pad(mask.numpy(), 1)
    outside = np.argwhere(~padded) - 1
    depth = np.min(np.hypot(rows[..., None] - outside[:, 0], columns[..., None] - outside[:, 1]), -1)
    core = np.argwhere(depth > radius)
    away = np.min(np.hypot(rows[..., None] - core[:, 0], columns[..., None] - core[:, 1]), -1)
    assert len(core)
    exact = torch.from_numpy(cv2.distanceTransform(padded.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    assert bool((opened_by_disc(exact, radius).numpy()[1:-1, 1:-1] == (away <= radius)).all())


def test_opening_keeps_a_wide_disc_and_takes_a_thin_bar() -> None:
    canvas = np.zeros((80, 120), np.uint8)
    cv2.circle(canvas, (40, 40), 25, 1, -1)
    cv2.rectangle(canvas, (60, 37), (110, 43), 1, -1)
    depth = cv2.distanceTransform(canvas, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    opened = opened_by_disc(torch.from_numpy(depth), 8.0)
    assert bool(opened[40, 40])
    assert not bool(opened[:, 75:].any())


def test_order_needs_two_pieces() -> None:
    assert order_fingers([(0.0, 0.0)], [(0.0, 5.0)], (0.0, 10.0), 5.0) is None


@pytest.mark.parametrize(
    ("field", "value"),
    [("smallest_disc", 0.0), ("largest_disc", 1.0), ("sizes", 1), ("min_elongation", 0.0), ("work_side_px", 10)],
)
def test_settings_name_what_is_wrong(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        replace(FingerSettings(), **{field: value})
