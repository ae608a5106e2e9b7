"""Overlap of masks, and the part of a picture in which a hand's silhouettes are compared."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.image.operations.overlaps import hand_region, intersection_over_union


def box(left: int, right: int) -> Tensor:
    mask = torch.zeros(10, 20, dtype=torch.bool)
    mask[2:6, left:right] = True
    return mask


def region(wrist: tuple[float, float], knuckle: tuple[float, float], reach_px: float = math.inf) -> Tensor:
    return hand_region((80, 100), torch.tensor(wrist), torch.tensor(knuckle), reach_px)


def test_known_overlaps() -> None:
    first = torch.stack([box(0, 8), box(0, 8), box(0, 8), box(0, 0)])
    second = torch.stack([box(0, 8), box(4, 12), box(8, 12), box(0, 0)])
    found = intersection_over_union(first, second)
    assert found[:3].tolist() == [1.0, 1 / 3, 0.0]
    assert bool(found[3].isnan())
    assert intersection_over_union(first, second, empty=0.0).tolist() == [1.0, 1 / 3, 0.0, 0.0]
    assert intersection_over_union(first.reshape(2, 2, 10, 20), second[0])[0].tolist() == [1.0, 1.0]


def test_only_the_region_counts() -> None:
    first, second = box(0, 8), box(4, 12)
    assert float(intersection_over_union(first, second, torch.arange(20).expand(10, 20) < 8)) == 1 / 2
    assert float(intersection_over_union(first, second, torch.arange(20).expand(10, 20) >= 8)) == 0.0
    assert math.isnan(float(intersection_over_union(first, second, torch.zeros_like(first))))


def test_the_region_begins_at_the_wrist_and_ends_at_its_reach() -> None:
    got = region((30.0, 40.0), (50.0, 25.0), 33.0)
    for y in range(80):
        for x in range(100):
            along = (x - 30.0) * 20.0 + (y - 40.0) * -15.0
            assert bool(got[y, x]) == (along >= 0 and math.hypot(x - 30.0, y - 40.0) < 33.0), (x, y)
    assert torch.equal(region((30.0, 40.0), (50.0, 25.0)), region((30.0, 40.0), (50.0, 25.0), 1e3))


def test_a_forearm_does_not_count() -> None:
    hand, arm = torch.zeros(80, 100, dtype=torch.bool), torch.zeros(80, 100, dtype=torch.bool)
    hand[20:40, 30:60], arm[20:40, :60] = True, True
    assert float(intersection_over_union(hand, arm)) == 0.5
    assert float(intersection_over_union(hand, arm, region((30.0, 30.0), (45.0, 30.0)))) == 1.0
    assert float(intersection_over_union(hand, arm, region((60.0, 30.0), (45.0, 30.0)))) == 0.5


@pytest.mark.parametrize("wrist", [(math.nan, 4.0), (12.0, 4.0)])
def test_an_unknown_wrist_or_a_palm_without_direction_cuts_nothing_off(wrist: tuple[float, float]) -> None:
    assert bool(region(wrist, (12.0, 4.0)).all())
