"""What the network is shown: silhouettes, and grey levels of which only the relief is left."""

import pytest
import torch
from torch import Tensor

from torchhand.propose.channels import gaussian_blur_of, network_channels, normalized_grey

SIDE = 48


def _hand(generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """A disc with a relief."""
    y, x = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    mask = ((x - 22).square() + (y - 25).square() < 300).float()
    relief = gaussian_blur_of(torch.randn(1, 1, SIDE, SIDE, generator=generator), 2.0)[:, 0]
    return mask[None], 0.5 + 0.2 * relief / relief.std()


@pytest.mark.parametrize(("gain", "offset"), [(1.0, -0.2), (0.8, 0.1), (1.3, 0.0)])
def test_light_and_colour_do_not_matter(gain: float, offset: float, generator: torch.Generator) -> None:
    """But for the little contrast that counts as noise."""
    mask, grey = _hand(generator)
    torch.testing.assert_close(
        normalized_grey(mask, gain * grey + offset), normalized_grey(mask, grey), atol=0.05, rtol=0.02
    )


def test_a_relief_is_seen_and_a_flat_hand_is_not(generator: torch.Generator) -> None:
    mask, grey = _hand(generator)
    assert float(normalized_grey(mask, grey)[mask > 0].std()) > 0.5
    assert float(normalized_grey(mask, torch.full_like(grey, 0.7)).abs().max()) < 1e-3


def test_surroundings_do_not_matter(generator: torch.Generator) -> None:
    mask, grey = _hand(generator)
    other = torch.where(mask > 0, grey, 1 - grey)
    seen, again = (network_channels(mask, levels, torch.ones_like(mask)) for levels in (grey, other))
    torch.testing.assert_close(seen, again)
    assert bool((seen[:, 1][mask == 0] == 0).all())


def test_what_is_outside_the_picture_is_no_hand(generator: torch.Generator) -> None:
    mask, grey = _hand(generator)
    known = torch.ones_like(mask)
    known[..., 30:] = 0
    seen = network_channels(mask, grey, known)
    torch.testing.assert_close(seen[:, 0, :, :30], 2 * mask[..., :30] - 1)
    assert bool((seen[:, 0, :, 30:] == -1).all())
    assert bool((seen[:, 2] == 1 - known).all())


@pytest.mark.parametrize("sigma", [0.8, 5.0])
def test_a_blur_keeps_the_sum_and_has_its_width(sigma: float) -> None:
    point = torch.zeros(1, 1, SIDE, SIDE, dtype=torch.float64)
    point[..., 24, 24] = 1
    blurred = gaussian_blur_of(point, sigma)[0, 0]
    steps = torch.arange(SIDE).double() - 24
    assert float(blurred.sum()) == pytest.approx(1.0, abs=1e-6)
    assert float((blurred.sum(0) * steps.square()).sum().sqrt()) == pytest.approx(sigma, rel=0.1)


def test_an_empty_mask_gives_numbers() -> None:
    nothing = torch.zeros(1, SIDE, SIDE)
    assert bool(network_channels(nothing, torch.rand(1, SIDE, SIDE), nothing + 1).isfinite().all())
