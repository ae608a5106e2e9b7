"""Open hands of real people: all fingers right with the mask given; by itself right, or refused, never wrong."""

from pathlib import Path

import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model, read_picture
from torchhand.fit.open_hand.fit import OpenHand, fit_open_hand
from torchhand.geometry import assumed_camera
from torchhand.image import HandRegions, divide_hand, find_open_hand
from torchhand.image.fingers import DIGITS

STILLS = "real/open_hand_stills"
BLACK = "real/open_hand_black"


def pictures(data_dir: Path, folder: str) -> list[Path]:
    found = sorted((data_dir / folder).glob("*.jpg"))
    if not found:
        pytest.skip(f"needs the pictures of {folder}, which are not in {data_dir}")
    return found


def given_mask(path: Path) -> torch.Tensor:
    return read_picture(path.with_name(f"{path.stem}_mask.png")).amax(-1) > 127


def test_five_fingers_on_every_mask(data_dir: Path) -> None:
    for path in pictures(data_dir, STILLS):
        regions = divide_hand(given_mask(path))
        assert isinstance(regions, HandRegions), path.name
        assert not regions.is_mirrored, path.name  # backs of right hands
        assert tuple(digit.name for digit in regions.digits) == DIGITS
        assert all(digit.profile.straightness < 0.12 for digit in regions.digits), path.name


def test_fitted_hands_cover_the_masks(data_dir: Path) -> None:
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    overlaps = []
    for path in pictures(data_dir, STILLS)[::3]:
        mask = given_mask(path)
        hand = fit_open_hand(mask, kinematics, assumed_camera(mask.shape[1], mask.shape[0]))
        assert isinstance(hand, OpenHand), path.name
        assert hand.facing == "back"
        overlaps.append(hand.overlap)
    assert min(overlaps) > 0.8
    assert float(np.median(overlaps)) > 0.9


def test_hands_before_black_are_found_alone(data_dir: Path) -> None:
    kinematics = load_hand_model().kinematics("left", dtype=torch.float64)
    for path in pictures(data_dir, BLACK):
        image = read_picture(path)
        found = find_open_hand(image)
        assert found.odd_digits == (), path.name
        hand = fit_open_hand(found.mask, kinematics, assumed_camera(image.shape[1], image.shape[0]))
        assert isinstance(hand, OpenHand), path.name
        assert hand.facing == "palm"
        assert hand.overlap > 0.8


def alone(paths: list[Path]) -> tuple[int, int]:
    """Of pictures without their masks, how many are right and how many are wrong; the others are refused."""
    right = wrong = 0
    for path in paths:
        found = find_open_hand(read_picture(path))
        regions, truth = divide_hand(found.mask), divide_hand(given_mask(path))
        if found.odd_digits or not isinstance(regions, HandRegions):
            continue
        assert isinstance(truth, HandRegions)
        tips, expected = (np.stack([digit.tip for digit in r.digits]) for r in (regions, truth))
        if np.hypot(*(tips - expected).T).max() < 0.06 * truth.hand_length:
            right += 1
        else:
            wrong += 1
    return right, wrong


def test_without_mask_right_or_refused(data_dir: Path) -> None:
    right, wrong = alone(pictures(data_dir, STILLS)[:15:4])
    assert wrong == 0
    assert right >= 2


@pytest.mark.slow
def test_all_are_right_without_masks(data_dir: Path) -> None:
    right, wrong = alone(pictures(data_dir, STILLS))
    assert wrong == 0
    assert right == 15


def test_a_wall_of_skins_colour_and_the_shade_of_a_flash_hide_no_finger(data_dir: Path) -> None:
    hard = [path for path in pictures(data_dir, STILLS) if path.stem[-6:] in ("id01_1", "id04_1", "id06_1")]
    assert alone(hard) == (3, 0)
