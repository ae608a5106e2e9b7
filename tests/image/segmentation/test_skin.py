"""Skin histograms: learned on painted pictures, looked up by two paths."""

import math

import pytest
import torch

from torchhand.image.segmentation.skin import SkinModel, learn_skin, skin_probability, skin_probability_torch

SKIN, WALL, BALL = (205, 150, 125), (150, 148, 160), (230, 210, 60)


def painted(generator: torch.Generator, noise: float = 6.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Wall with a block of skin whose brightness falls off, and a yellow ball; the picture and the skin's mask."""
    image = torch.empty(80, 100, 3)
    image[:] = torch.tensor(WALL, dtype=torch.float32)
    image[5:20, 5:20] = torch.tensor(BALL, dtype=torch.float32)
    mask = torch.zeros(80, 100, dtype=torch.bool)
    mask[20:70, 40:75] = True
    shade = torch.linspace(1.0, 0.5, 80)[:, None, None]
    image = torch.where(mask[..., None], torch.tensor(SKIN) * shade, image)
    image = image + noise * torch.randn(80, 100, 3, generator=generator)
    return image.clamp(0, 255).to(torch.uint8), mask


def test_learned_skin_is_recognised_in_another_picture(generator: torch.Generator) -> None:
    image, mask = painted(generator)
    model = learn_skin(image, mask)
    other, _ = painted(generator)
    probability = skin_probability(other.flip(1), model)
    truth = mask.flip(1)
    assert float(probability.min()) >= 0.0
    assert float(probability.max()) <= 1.0
    assert float((probability[truth] > 0.5).float().mean()) > 0.99
    assert float((probability[~truth] > 0.5).float().mean()) < 0.01


def test_fast_and_plain_look_up_agree(generator: torch.Generator) -> None:
    image, mask = painted(generator)
    noise = torch.randint(0, 256, (70, 90, 3), generator=generator, dtype=torch.uint8)
    for bins in (16, 32):
        model = learn_skin(image, mask, bins=bins)
        for picture in (image, noise, noise // 4):
            assert torch.equal(skin_probability(picture, model), skin_probability_torch(picture, model))


def test_overlapping_colours_share_by_their_frequencies() -> None:
    """A colour on 3/4 of the skin and 1/4 of the rest is skin with probability 3/4, whatever the areas."""
    both, other = torch.tensor([200, 120, 90], dtype=torch.uint8), torch.tensor([90, 120, 200], dtype=torch.uint8)
    image = other.expand(20, 100, 3).clone()
    mask = torch.zeros(20, 100, dtype=torch.bool)
    mask[:, :20] = True
    image[:, :15] = both
    image[:, 20:40] = both
    probability = skin_probability(image, learn_skin(image, mask, smoothing_bins=0.0))
    assert float(probability[0, 0]) == pytest.approx(0.75, abs=0.01)
    assert float(probability[0, 99]) == pytest.approx(0.25, abs=0.01)


def test_hue_wraps_around() -> None:
    image = torch.full((10, 20, 3), 128, dtype=torch.uint8)
    image[:, :10] = torch.tensor([200, 100, 101], dtype=torch.uint8)  # hue just below 360 degrees
    mask = torch.zeros(10, 20, dtype=torch.bool)
    mask[:, :10] = True
    model = learn_skin(image, mask)
    beyond = torch.tensor([[[200, 101, 100], [100, 200, 100]]], dtype=torch.uint8)
    red, green = skin_probability(beyond, model)[0].tolist()
    assert red > 0.9
    assert green < 0.5


def test_unseen_colour_is_background(generator: torch.Generator) -> None:
    image, mask = painted(generator)
    model = learn_skin(image, mask)
    blue = torch.tensor([10, 20, 250], dtype=torch.uint8).expand(2, 2, 3).contiguous()
    assert float(skin_probability(blue, model).max()) < 0.5


def test_dark_pixels_are_counted_together() -> None:
    model = SkinModel(log_ratio=torch.full((32, 32), 5.0), dark_log_ratio=-math.log(3.0), dark_value=40)
    image = torch.tensor([[[39, 10, 5], [40, 10, 5], [0, 0, 0]]], dtype=torch.uint8)
    dark, bright, black = skin_probability(image, model)[0].tolist()
    assert dark == pytest.approx(0.25, abs=1 / 255)
    assert black == dark
    assert bright > 0.99


def test_ignored_pixels_teach_nothing(generator: torch.Generator) -> None:
    image, mask = painted(generator)
    spoiled = image.clone()
    spoiled[0:4] = torch.tensor(SKIN, dtype=torch.uint8)
    ignore = torch.zeros_like(mask)
    ignore[0:4] = True
    kept = learn_skin(spoiled, mask, ignore)
    assert torch.equal(kept.log_ratio, learn_skin(image, mask, ignore).log_ratio)
    assert not torch.equal(kept.log_ratio, learn_skin(spoiled, mask).log_ratio)


def test_empty_classes_are_refused(generator: torch.Generator) -> None:
    image, mask = painted(generator)
    with pytest.raises(ValueError, match="at least one skin pixel"):
        learn_skin(image, torch.zeros_like(mask))
    with pytest.raises(ValueError, match="at least one background pixel"):
        learn_skin(image, mask, ~mask)
