"""Noise of a mask's boundary: as large as ordered, only there, and seeded."""

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.simulate.scene.mask_noise import noisy_mask


def disc(radius: float, size: int = 400) -> Tensor:
    axis = torch.arange(size, dtype=torch.float64) - 0.5 * (size - 1)
    return axis[:, None].square() + axis[None].square() <= radius**2


@pytest.mark.parametrize("std_px", [0.5, 1.0, 2.0])
def test_the_boundary_is_off_as_ordered(std_px: float) -> None:
    mask = disc(150.0)
    found = noisy_mask(mask, std_px, torch.Generator().manual_seed(1))
    contours, _ = cv2.findContours(found.numpy().astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(contours, key=len)[:, 0] - 199.5
    off = np.linalg.norm(outline, axis=1) - 149.5
    assert abs(float(np.median(off))) < 0.5 * std_px + 0.3
    assert 0.7 * std_px < float(off.std()) < 1.4 * std_px + 0.3
    changed = (found != mask).nonzero() - 199.5
    assert float((changed.norm(dim=-1) - 150).abs().max()) < 5 * std_px + 1


def test_no_holes_away_from_the_boundary() -> None:
    mask = disc(150.0)
    found = noisy_mask(mask, 1.0, torch.Generator().manual_seed(2))
    assert bool(found[disc(143.0)].all())
    assert not bool(found[~disc(157.0)].any())


def test_seed_zero_and_empty() -> None:
    mask = disc(20.0, 64)
    one, same, other = (noisy_mask(mask, 1.0, torch.Generator().manual_seed(seed)) for seed in (3, 3, 4))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)
    assert torch.equal(noisy_mask(mask, 0.0, torch.Generator()), mask)
    empty = torch.zeros(20, 30, dtype=torch.bool)
    assert not bool(noisy_mask(empty, 1.0, torch.Generator()).any())
    assert bool(noisy_mask(~empty, 1.0, torch.Generator()).all())
    with pytest.raises(ValueError, match="std_px: expected 0 or more, got -1"):
        noisy_mask(mask, -1.0, torch.Generator())
