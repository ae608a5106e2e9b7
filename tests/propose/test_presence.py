"""Whether a view shows a hand: the shipped network on hands and on what is none."""

from typing import Any

import pytest
import torch

from torchhand.files import load_presence_network
from torchhand.hand import HandPose
from torchhand.propose import PresenceNetwork, Silhouette, hand_presence


def _presence(placed: Any, mask: torch.Tensor) -> float:
    here = HandPose(dofs=placed.pose, reference=placed.root_reference)
    silhouette = Silhouette(mask=mask, camera=placed.camera)
    return float(hand_presence(load_presence_network(), silhouette, placed.kinematics, here, placed.shape))


def _disc(placed: Any) -> torch.Tensor:
    """A disc of the hand's area about its middle."""
    rows, columns = placed.mask.nonzero().double().mean(0)
    y, x = (torch.arange(size, dtype=torch.float64) for size in placed.mask.shape)
    return (x - columns).square() + (y[:, None] - rows).square() < float(placed.mask.sum()) / torch.pi


@pytest.mark.parametrize("side", ["right", "left"])
def test_hands_are_told_from_discs_and_bars(studio: Any, side: str) -> None:
    placed = studio.placed(size=0.8, side=side)
    hand = _presence(placed, placed.mask)
    bar = torch.zeros_like(placed.mask)
    columns = placed.mask.nonzero()[:, 1]
    middle = int(columns.double().mean())
    bar[:, middle - 8 : middle + 8] = True
    assert hand > 3
    assert _presence(placed, _disc(placed)) < min(0.0, hand)
    assert _presence(placed, bar) < min(0.0, hand)


def test_left_hands_are_right_ones_in_the_mirror(studio: Any) -> None:
    found = [_presence(one, one.mask) for one in (studio.placed(size=0.8), studio.placed(size=0.8, side="left"))]
    assert found[0] == pytest.approx(found[1], abs=0.3)


def test_what_makes_no_network_or_no_view_is_refused(studio: Any) -> None:
    with pytest.raises(ValueError, match="width: expected 1 to 4096, got 0"):
        PresenceNetwork(width=0)
    placed = studio.placed(camera=studio.camera(kind="orthographic"))
    with pytest.raises(ValueError, match="expected a pinhole camera, got orthographic"):
        _presence(placed, placed.mask)
