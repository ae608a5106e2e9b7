"""Photographs of any size: the hand that is found in the small picture, at full resolution and bounded work."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model, read_picture
from torchhand.fit.open_hand import OpenHand, fit_open_hand, hand_in_picture
from torchhand.geometry import Camera, assumed_camera

_SMALL = (283, 200)


@pytest.fixture(scope="module")
def small(data_dir: Path) -> torch.Tensor:
    return read_picture(data_dir / "real" / "open_hand_black" / "IMG-1843.jpg")


def _enlarged(small: torch.Tensor, height: int, width: int) -> np.ndarray:
    return cv2.resize(small.numpy(), (width, height), interpolation=cv2.INTER_CUBIC)


def _fit(image: torch.Tensor, camera: Camera, mask: torch.Tensor | None = None) -> tuple[OpenHand, np.ndarray]:
    """The fit, and the tips of its digits in the whole picture."""
    seen = hand_in_picture(image, mask)
    assert seen.part.size[0] * seen.part.size[1] <= 640 * 480 + 640
    kinematics = load_hand_model().kinematics("left", dtype=torch.float64)
    hand = fit_open_hand(seen.silhouette.mask, kinematics, seen.camera(camera))
    assert isinstance(hand, OpenHand)
    return hand, np.array([seen.part.whole_px(digit.tip) for digit in hand.regions.digits])


def test_a_photograph_of_12_megapixels(small: torch.Tensor):
    """The hand of the small picture: the same digits, the same proportions, in pixels of the large one."""
    first, tips = _fit(small, assumed_camera(*_SMALL[::-1]))
    image = torch.from_numpy(_enlarged(small, 4032, 3024))
    again, enlarged_tips = _fit(image, assumed_camera(3024, 4032))
    scale = np.array([3024 / _SMALL[1], 4032 / _SMALL[0]])
    np.testing.assert_allclose((enlarged_tips + 0.5) / scale - 0.5, tips, atol=2.0)
    assert again.overlap > first.overlap - 0.03
    torch.testing.assert_close(again.fit.shape, first.fit.shape, atol=0.1, rtol=0.1)


def test_a_small_hand_in_a_large_photograph_is_cut_out(small: torch.Tensor):
    """A hand that takes a fortieth of the picture is measured in a part about it, not in the reduced whole."""
    image = np.full((3000, 4000, 3), 12, np.uint8)
    x, y, height, width = 1500, 700, 990, 700
    image[y : y + height, x : x + width] = _enlarged(small, height, width)
    whole = torch.from_numpy(image)
    seen = hand_in_picture(whole)
    assert seen.part.scale > 0.5 > 2 * (640 * 480 / (3000 * 4000)) ** 0.5
    camera = assumed_camera(4000, 3000)
    hand, tips = _fit(whole, camera)
    assert hand.overlap > 0.9
    assert ((tips > (x, y)) & (tips < (x + width, y + height))).all()
    tip = hand.fit.pose[:3] / hand.fit.pose[2]  # the wrist is seen where the silhouette has it
    wrist = camera.intrinsics.double() @ tip
    assert bool((wrist[:2] > torch.tensor((x, y))).all() and (wrist[:2] < torch.tensor((x + width, y + height))).all())
    given = hand_in_picture(whole, torch.from_numpy(image.max(-1) > 60))
    assert given.part.scale > 0.5
    assert given.silhouette.source == "given"
