"""Colours learned from one picture, and the regions in which silhouettes are compared."""

import math
from typing import Any

import pytest
import torch

from torchhand.fit.appearance import disc, grey, learn_appearance, mask_plane
from torchhand.simulate import SceneSettings


def test_learned_colours_tell_the_hand_from_clutter_in_another_picture(studio: Any) -> None:
    scene = SceneSettings(supersampling=2, background="clutter", noise=3.0)
    first, second = studio.placed(angle_deg=10.0), studio.placed(angle_deg=-25.0, at=(0.15, 0.0))
    appearance = learn_appearance(first.picture(scene, seed=2), first.mask, ~first.mask, 1)
    assert appearance is not None
    probability = appearance.probability(second.picture(scene, seed=2))
    assert probability.dtype == torch.float32
    assert float(probability.min()) >= 0
    assert float(probability.max()) <= 1
    assert float((probability[second.mask] > 0.5).float().mean()) > 0.95
    # About a tenth of the clutter has the colours of skin.
    assert float((probability[~second.mask] > 0.5).float().mean()) < 0.15


def test_the_margin_keeps_mixed_colours_out() -> None:
    image = torch.full((60, 80, 3), 20, dtype=torch.uint8)
    image[20:40, 20:60] = torch.tensor((200, 150, 120), dtype=torch.uint8)
    mask = torch.zeros(60, 80, dtype=torch.bool)
    mask[18:42, 18:62] = True  # drawn 2 px too large: its rim shows the background
    sharp, soft = (learn_appearance(image, mask, ~mask, margin) for margin in (3, 1))
    assert sharp is not None
    assert soft is not None
    background = (slice(0, 10), slice(0, 80))
    assert float(sharp.probability(image)[background].max()) < float(soft.probability(image)[background].min())


@pytest.mark.parametrize("is_hand_empty", [True, False])
def test_nothing_is_learned_from_nothing(is_hand_empty: bool) -> None:
    image = torch.zeros(40, 40, 3, dtype=torch.uint8)
    few, many = torch.zeros(40, 40, dtype=torch.bool), torch.ones(40, 40, dtype=torch.bool)
    few[10:18, 10:18] = True  # 64 pixels, of which a margin of 2 leaves 16
    hand, other = (few, many) if is_hand_empty else (many, few)
    assert learn_appearance(image, hand, other, 2) is None


def test_grey_is_luminance() -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.randint(0, 256, (7, 9, 3), generator=generator, dtype=torch.uint8)
    weights = torch.tensor((0.299, 0.587, 0.114))  # ITU-R BT.601
    torch.testing.assert_close(grey(image), (image.float() @ weights) / 255, rtol=0, atol=0.6 / 255)


def test_the_plane_of_a_mask_crosses_a_half_on_its_outline() -> None:
    mask = torch.zeros(30, 40, dtype=torch.bool)
    mask[:, 20:] = True
    plane = mask_plane(mask)
    assert float(plane[15, 19]) < 0.5 < float(plane[15, 20])
    torch.testing.assert_close(plane[15, 19] + plane[15, 20], torch.tensor(1.0))
    assert float(plane[15, 25]) > 0.999


def test_a_disc() -> None:
    drawn = disc((20, 30), torch.tensor((12.5, 7.0)), 4.0)
    expected = [[math.hypot(x - 12.5, y - 7.0) < 4.0 for x in range(30)] for y in range(20)]
    assert drawn.tolist() == expected
