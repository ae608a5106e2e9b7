"""Digits that may not be in one another."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import PosedHands, Stage
from torchhand.fit.hull.penetration import PenetrationPrior
from torchhand.fit.hull.skin import SkinPoints
from torchhand.hand import (
    DOFS,
    Hand,
    HandPose,
    PenetrationSettings,
    penetration,
    place_primitives,
    posture,
    primitive_sizes,
)

STAGE = Stage(gross_m=0.01, rounds=1, iterations=1)


def crossed(side: float = 1.0) -> Tensor:
    """An open hand whose index and middle finger lie across each other."""
    dofs = posture("open", dtype=torch.float64)
    dofs[DOFS.index("index_mcp_aa")] = side * math.radians(14.0)
    dofs[DOFS.index("middle_mcp_aa")] = side * math.radians(-14.0)
    return dofs


def posed(hand: Hand, dofs: Tensor) -> PosedHands:
    reference = torch.linalg.qr(torch.tensor(((0.3, 0.5, 0.1), (0.2, -0.4, 0.9), (0.7, 0.1, 0.2)))).Q.double()
    return PosedHands(pose=HandPose.of(dofs, reference.expand(len(dofs), 3, 3)), shape=hand.shape)


@pytest.fixture(params=["right", "left"], scope="module")
def hand(request: pytest.FixtureRequest) -> Hand:
    return load_hand_model().hand(side=request.param, dtype=torch.float64)


@pytest.fixture(scope="module")
def hands(hand: Hand) -> PosedHands:
    """Index and middle finger across each other one way and the other, and curled fingers with the thumb in them."""
    fist = posture("fist", dtype=torch.float64)
    fist[DOFS.index("thumb_cmc_fe")] += 0.5
    return posed(hand, torch.stack([crossed(), crossed(-1.0), fist]))


def test_the_cost_is_that_of_the_depths_between_digits(hand: Hand, hands: PosedHands) -> None:
    settings = PenetrationSettings()
    frames = hand.kinematics(hands.pose.dofs, hand.shape, root_reference=hands.pose.reference)
    sizes = primitive_sizes(hand.kinematics.shape_space, hand.shape)
    depths = penetration(place_primitives(frames, sizes, is_left=hand.kinematics.side == "left"), settings)
    between = [index for index, name in enumerate(depths.names) if "palm" not in name and "thenar" not in name]
    square = (depths.excess[:, between] / settings.softness / 3.0).square()  # Cauchy beyond three
    expected = 0.5 * 9.0 * square.log1p().sum(-1)
    found = PenetrationPrior(skin=SkinPoints(hand), settings=settings).equations(hands).cost
    assert float(expected.max()) > 1.0
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-9)


def test_the_gradient_is_the_derivative_of_the_cost(hand: Hand, hands: PosedHands) -> None:
    prior = PenetrationPrior(skin=SkinPoints(hand), weight=0.7).associate(hands, STAGE)
    found = prior.equations(hands)
    step = 1e-7
    for column in range(6, 36):
        there = [
            prior.equations(posed(hand, hands.pose.dofs.index_add(1, torch.tensor([column]), delta))).cost
            for delta in (torch.full((len(hands), 1), side * step, dtype=torch.float64) for side in (1, -1))
        ]
        slope = (there[0] - there[1]) / (2 * step)
        torch.testing.assert_close(found.gradient[:, column - 6], slope, rtol=1e-4, atol=1e-3)


def test_hands_whose_digits_are_apart_cost_nothing(hand: Hand) -> None:
    found = PenetrationPrior(skin=SkinPoints(hand)).equations(posed(hand, posture("open", dtype=torch.float64)[None]))
    assert float(found.cost) == 0.0
    assert not found.gradient.any()
    assert not found.matrix.any()


def test_pairs_that_are_apart_are_left_out_on_a_processor_alone(
    hand: Hand, hands: PosedHands, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What an accelerator does for all pairs is done for those that meet: the same sums."""
    apart = posed(hand, posture("open", dtype=torch.float64)[None])
    prior = PenetrationPrior(skin=SkinPoints(hand))
    found = [prior.equations(own) for own in (hands, apart)]
    monkeypatch.setattr("torchhand.fit.hull.penetration.is_host", lambda device: False)
    for own, few in zip((hands, apart), found, strict=True):
        whole = prior.equations(PosedHands(pose=own.pose, shape=own.shape))
        for name in ("cost", "gradient", "matrix"):
            torch.testing.assert_close(getattr(few, name), getattr(whole, name), rtol=1e-12, atol=1e-9)
    assert not bool(found[1].matrix.any())
