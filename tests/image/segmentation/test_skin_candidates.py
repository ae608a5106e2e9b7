"""Pieces that may be a hand, where hue alone does not divide the picture."""

import torch

from torchhand.image import skin_candidates

SKIN = torch.tensor((205, 150, 125), dtype=torch.uint8)
WOOD = torch.tensor((62, 44, 36), dtype=torch.uint8)  # of the same hue, in the shade


def _picture(background: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """A bar of skin before a background, with noise, and where it is."""
    noise = torch.randint(-6, 7, (90, 120, 3), generator=torch.Generator().manual_seed(0))
    is_skin = torch.zeros(90, 120, dtype=torch.bool)
    is_skin[20:70, 45:75] = True
    picture = torch.where(is_skin[..., None], SKIN, background).int() + noise
    return picture.clamp(0, 255).to(torch.uint8), is_skin


def _overlap(one: torch.Tensor, other: torch.Tensor) -> float:
    return float((one & other).sum() / (one | other).sum())


def test_skin_before_wood_of_its_hue_is_among_the_pieces() -> None:
    picture, is_skin = _picture(WOOD)
    found = skin_candidates(picture)
    assert max(_overlap(one, is_skin) for one in found) > 0.95
    assert max(_overlap(one, other) for one in found for other in found if one is not other) < 0.9


def test_what_is_not_of_skin_s_hue_is_none() -> None:
    assert skin_candidates(torch.full((90, 120, 3), 128, dtype=torch.uint8)) == []


def test_large_pictures_are_reduced_and_give_the_same_every_time() -> None:
    picture, _ = _picture(WOOD)
    large = picture.repeat_interleave(4, 0).repeat_interleave(4, 1)
    first, second = skin_candidates(large), skin_candidates(large)
    assert first[0].shape == (180, 240)
    assert all(torch.equal(*pair) for pair in zip(first, second, strict=True))
