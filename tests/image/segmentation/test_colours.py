"""Joint colour histograms."""

import pytest
import torch

from torchhand.image.segmentation.colours import (
    foreground_probability,
    foreground_probability_torch,
    learn_colours,
    relearn_colours,
)


def clutter(generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Random patches of every colour, and a block of one colour of varying brightness."""
    patches = torch.randint(0, 256, (12, 16, 3), generator=generator, dtype=torch.uint8)
    image = patches.repeat_interleave(8, 0).repeat_interleave(8, 1)
    mask = torch.zeros(96, 128, dtype=torch.bool)
    mask[20:80, 40:90] = True
    shade = torch.rand(96, 128, 1, generator=generator) * 0.2 + 0.8
    image = torch.where(mask[..., None], (torch.tensor([210.0, 150.0, 120.0]) * shade).to(torch.uint8), image)
    return image, mask


def test_inside_stands_out_of_clutter(generator: torch.Generator) -> None:
    image, mask = clutter(generator)
    inside, outside = mask.clone(), ~mask
    inside[:, :60] = False  # only half of it is known, and nothing of the right part of the surroundings
    outside[:, 100:] = False
    probability = foreground_probability(image, learn_colours(image, inside, outside))
    assert float((probability[mask] > 0.5).float().mean()) > 0.98
    assert float((probability[~mask] > 0.5).float().mean()) < 0.1


def test_fast_and_plain_look_up_agree(generator: torch.Generator) -> None:
    image, mask = clutter(generator)
    noise = torch.randint(0, 256, (50, 60, 3), generator=generator, dtype=torch.uint8)
    for bins in (16, 32):
        model = learn_colours(image, mask, ~mask, bins=bins)
        for picture in (image, noise):
            assert torch.equal(foreground_probability(picture, model), foreground_probability_torch(picture, model))


def test_class_areas_do_not_matter() -> None:
    image = torch.zeros(20, 100, 3, dtype=torch.uint8)
    mask = torch.zeros(20, 100, dtype=torch.bool)
    mask[:, :10] = True
    image[:, 5:55] = 200  # half of each class
    probability = foreground_probability(image, learn_colours(image, mask, ~mask, smoothing_bins=0.0))
    assert probability.tolist()[0][0] == pytest.approx(0.5, abs=0.01)
    assert probability.tolist()[0][99] == pytest.approx(0.5, abs=0.01)


def test_empty_sets_are_refused(generator: torch.Generator) -> None:
    image, mask = clutter(generator)
    with pytest.raises(ValueError, match="at least one inside pixel"):
        learn_colours(image, torch.zeros_like(mask), mask)
    with pytest.raises(ValueError, match="at least one outside pixel"):
        learn_colours(image, mask, torch.zeros_like(mask))


def _two_colours(hand: tuple[int, int, int], other: tuple[int, int, int]) -> tuple[torch.Tensor, torch.Tensor]:
    """A picture whose left half has one colour and whose right half another, and the mask of the left one."""
    image = torch.empty(40, 80, 3, dtype=torch.uint8)
    image[:, :40], image[:, 40:] = torch.tensor(hand, dtype=torch.uint8), torch.tensor(other, dtype=torch.uint8)
    mask = torch.zeros(40, 80, dtype=torch.bool)
    mask[:, :40] = True
    return image, mask


def test_colours_are_relearned_step_by_step_and_others_are_not_forgotten() -> None:
    day, mask = _two_colours((200, 150, 120), (20, 30, 40))
    night, _ = _two_colours((60, 20, 10), (200, 150, 121))  # the surroundings take on the hand's old colour
    dusk, _ = _two_colours((100, 60, 40), (20, 60, 90))
    model = learn_colours(day, mask, ~mask)
    before = foreground_probability(night, model)
    assert float(before[mask].max()) < 0.5
    assert float(before[~mask].min()) > 0.9
    for _ in range(8):
        model = relearn_colours(model, dusk, mask, ~mask, keep=0.7)
    assert float(foreground_probability(day, model)[mask].min()) > 0.9  # not in sight, and not forgotten
    assert float(foreground_probability(day, model)[~mask].max()) < 0.1
    assert float(foreground_probability(dusk, model)[mask].min()) > 0.9
    once = relearn_colours(model, night, mask, ~mask, keep=0.7)
    assert float(foreground_probability(night, once)[~mask].min()) > 0.5  # one picture does not turn a colour over
    for _ in range(8):
        model = relearn_colours(model, night, mask, ~mask, keep=0.7)
    after = foreground_probability(night, model)
    assert float(after[mask].min()) > 0.9
    assert float(after[~mask].max()) < 0.1


def test_nothing_changes_where_all_is_kept_and_all_where_nothing_is() -> None:
    day, mask = _two_colours((200, 150, 120), (20, 30, 40))
    night, _ = _two_colours((60, 20, 10), (200, 150, 121))
    model = learn_colours(day, mask, ~mask)
    assert torch.equal(relearn_colours(model, night, mask, ~mask, keep=1.0).log_ratio, model.log_ratio)
    fresh = learn_colours(night, mask, ~mask)
    now = foreground_probability(night, relearn_colours(model, night, mask, ~mask, keep=0.0))
    torch.testing.assert_close(now, foreground_probability(night, fresh), atol=0.02, rtol=0)
