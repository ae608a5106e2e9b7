"""Valleys on lines that are known: place between the pixels, hysteresis, silence on edges and at a region's rim."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.image.contours.valleys import find_valleys

SIZE = 96


def line(
    angle_deg: float, offset: float, *, depth: float = 60.0, half_width: float = 1.0, level: float = 180.0
) -> Tensor:
    """A dark line with a smooth profile through (offset from) the middle, and everywhere else one grey level."""
    y, x = torch.meshgrid(torch.arange(SIZE).double(), torch.arange(SIZE).double(), indexing="ij")
    angle = math.radians(angle_deg)
    across = (x - SIZE / 2) * math.cos(angle) + (y - SIZE / 2) * math.sin(angle) - offset
    return (level - depth * torch.exp(-0.5 * (across / half_width).square())).float()


@pytest.mark.parametrize("angle_deg", [0.0, 17.0, 45.0, 90.0, 133.0])
@pytest.mark.parametrize("offset", [0.0, 0.3, -0.45])
def test_dark_lines_are_found_to_a_tenth_of_a_pixel(angle_deg: float, offset: float) -> None:
    found = find_valleys(line(angle_deg, offset))
    angle = torch.tensor(math.radians(angle_deg)).double()
    normal = torch.stack((angle.cos(), angle.sin()))
    inner = ((found.points_px - SIZE / 2).abs() < SIZE / 2 - 8).all(-1)
    points = found.points_px[inner] - SIZE / 2
    assert len(points) >= SIZE - 20
    assert float((points @ normal - offset).abs().max()) < 0.1
    assert float((found.directions[inner] @ normal).abs().min()) > 0.999


def test_bright_lines_and_edges_are_silent() -> None:
    bright = 360 - line(20.0, 0.2)
    assert len(find_valleys(bright).points_px) == 0
    y, x = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    edge = torch.where(x + 0.3 * y > 60, 200.0, 60.0)
    assert len(find_valleys(edge).points_px) == 0


def test_weak_parts_count_only_beside_strong_ones() -> None:
    """One line that fades out is followed; a line as faint as its end is none by itself."""
    fading = line(0.0, 0.0)
    fraction = torch.linspace(1.0, 0.12, SIZE)[:, None]
    fading = 180 - fraction * (180 - fading)
    followed = find_valleys(fading)
    assert float(followed.points_px[:, 1].max()) > SIZE - 20
    assert float(followed.strength.min()) < 7.0
    faint = find_valleys(180 - 0.2 * (180 - line(0.0, 0.0)))
    assert len(faint.points_px) == 0


@pytest.mark.parametrize(("rows", "is_line"), [(10, False), (20, True)])
def test_short_pieces_are_dropped(rows: int, is_line: bool) -> None:
    """Of one line, as much as a region shows clear of its rim."""
    band = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    band[40 : 40 + rows] = True
    assert bool(len(find_valleys(line(0.0, 0.0), within=band).points_px)) == is_line


def test_the_rim_of_the_region_makes_no_valley() -> None:
    """A bright hand before a dark ground, then one before a bright ground with a dark seam: only the crease counts."""
    y, x = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    hand = ((x - 48).square() + (y - 48).square()) < 38**2
    crease = line(0.0, 0.0)
    for ground in (20.0, 250.0):
        picture = torch.where(hand, crease, torch.full_like(crease, ground))
        found = find_valleys(picture, within=hand)
        assert len(found.points_px) > 50
        assert float((found.points_px[:, 0] - 48).abs().max()) < 0.3
        assert bool(hand[found.points_px[:, 1].round().long(), found.points_px[:, 0].round().long()].all())


def test_flat_pictures_and_empty_regions_have_none() -> None:
    flat = torch.full((40, 50), 99.0)
    assert len(find_valleys(flat).points_px) == 0
    assert len(find_valleys(line(0.0, 0.0), within=torch.zeros(SIZE, SIZE, dtype=torch.bool)).points_px) == 0
