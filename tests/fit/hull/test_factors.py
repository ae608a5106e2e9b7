"""Laws of both factors of a hull: exact gradients in pose and shape, hypotheses apart, association at the shape."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit import PosedHands, SharedUnknowns, Stage
from torchhand.fit.hull.fitter import HullFitter
from torchhand.fit.hull.settings import HullSettings
from torchhand.fit.hull.skin import SkinPoints
from torchhand.hand import HandPose, named_pose_space

SPACE = named_pose_space("dof36")
STAGE = Stage(gross_m=0.006)
KINDS = ("inside", "surface", "rays")


def observation(rig: Any, kind: str) -> Any:
    pose, shape = rig.person(4)
    masks = rig.masks(pose, shape)
    target = rig.with_edges(masks, rays=80) if kind == "rays" else rig.target_of_masks(masks, points=80)
    fitter = HullFitter(hand=rig.hand, space=SPACE, settings=HullSettings(vertices=80, rigidity_exponent=1.5))
    return fitter.observations(target)[0 if kind == "inside" else 1]


def starts(rig: Any) -> HandPose:
    pose, _ = rig.person(4)
    return HandPose.stack([rig.moved(pose, seed, deg=8, mm=8) for seed in (1, 2, 3)])


def turned(pose: HandPose) -> HandPose:
    """With rotation vectors that are not zero."""
    return HandPose(dofs=pose.dofs + 0.02, reference=pose.reference)


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_is_that_of_the_cost(rig: Any, kind: str) -> None:
    pose = starts(rig)
    factor = observation(rig, kind).associate(PosedHands(pose=pose, shape=rig.hand.shape), STAGE)
    here = turned(pose)

    def cost(dofs: Tensor) -> Tensor:
        hands = PosedHands(pose=HandPose(dofs=dofs, reference=here.reference), shape=rig.hand.shape)
        return factor.equations(hands).cost.sum()

    found = factor.equations(PosedHands(pose=here, shape=rig.hand.shape))
    expected = torch.func.grad(cost)(here.dofs)
    scale = float(expected.abs().max())
    assert scale > 1
    torch.testing.assert_close(found.gradient, expected, rtol=1e-8, atol=1e-8 * scale)
    assert float(torch.linalg.eigvalsh(found.matrix).min()) > -1e-6 * float(found.matrix.abs().max())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("columns", [None, (0, 1, 7, 30)])
def test_gradient_in_the_shape(rig: Any, kind: str, columns: tuple[int, ...] | None) -> None:
    pose = starts(rig)[:1]
    unknowns = SharedUnknowns.of_shape(rig.model.prior().population, columns)
    start = rig.hand.shape

    def hands(at: HandPose, vector: Tensor) -> PosedHands:
        return PosedHands(pose=at, shape=unknowns.shape(vector, start), unknowns=unknowns)

    vector = unknowns.vector(start)
    vector = vector + 0.5 * rig.model.shape_space.std[list(unknowns.columns)]
    factor = observation(rig, kind).associate(hands(pose, vector), STAGE)
    here = turned(pose)
    found = factor.equations(hands(here, vector))
    expected = torch.func.grad(lambda x: factor.equations(hands(here, x)).cost.sum())(vector)
    assert found.shared_gradient is not None
    assert found.shared_matrix is not None
    assert found.mixed is not None
    scale = float(expected.abs().max())
    torch.testing.assert_close(found.shared_gradient[0], expected, rtol=1e-6, atol=1e-6 * scale)
    whole = torch.cat(
        (torch.cat((found.matrix, found.mixed), -1), torch.cat((found.mixed.mT, found.shared_matrix), -1)), 1
    )
    assert float(torch.linalg.eigvalsh(whole).min()) > -1e-9 * float(whole.abs().max())


@pytest.mark.parametrize("kind", KINDS)
def test_hands_are_independent(rig: Any, kind: str) -> None:
    own, pose = observation(rig, kind), starts(rig)
    together = own.associate(PosedHands(pose=pose, shape=rig.hand.shape), STAGE)
    whole = together.equations(PosedHands(pose=turned(pose), shape=rig.hand.shape))
    rows = torch.tensor([2, 0])
    some = together.rows(rows).equations(PosedHands(pose=turned(pose)[rows], shape=rig.hand.shape))
    alone = PosedHands(pose=pose[1:2], shape=rig.hand.shape)
    single = own.associate(alone, STAGE)
    one = single.equations(PosedHands(pose=turned(pose)[1:2], shape=rig.hand.shape))
    for name in ("cost", "gradient", "matrix"):
        torch.testing.assert_close(getattr(some, name), getattr(whole, name)[rows])
        torch.testing.assert_close(getattr(one, name)[0], getattr(whole, name)[1])
    [explanation], [both] = single.explained(), together.explained()
    torch.testing.assert_close(explanation.fraction[0], both.fraction[1])
    torch.testing.assert_close(together.rows(rows).explained()[0].distance, both.distance[rows])


@pytest.mark.parametrize("kind", KINDS)
def test_data_are_associated_with_the_hand_of_the_shape_in_question(rig: Any, kind: str) -> None:
    """Where the shape is unknown, the one that the fitter started from does not matter."""
    pose, shape = rig.person(4)
    own = observation(rig, kind)
    unknowns = SharedUnknowns.of_shape(rig.model.prior().population)
    hands = PosedHands(pose=HandPose.stack([pose]), shape=shape, unknowns=unknowns)
    exact = replace(own, vertices=replace(own.vertices, skin=SkinPoints(rig.hand, shape)))
    held = PosedHands(pose=hands.pose, shape=shape)
    one, other = own.associate(hands, STAGE).equations(hands), exact.associate(held, STAGE).equations(held)
    torch.testing.assert_close(one.cost, other.cost)
    torch.testing.assert_close(one.gradient, other.gradient)
