"""Skin outside a hull: what it costs, what is within does not count, what is told of it."""

from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit import PosedHands, Stage
from torchhand.fit.hull.inside import InsideObservation
from torchhand.fit.hull.settings import HullSettings
from torchhand.fit.hull.skin import SkinPoints
from torchhand.fit.hull.target import HullTarget
from torchhand.fit.hull.vertices import SkinVertices
from torchhand.hand import HandPose


@dataclass(frozen=True)
class Ball:
    """The field of a ball about the origin."""

    radius: float

    def sample(self, points: Tensor, /) -> tuple[Tensor, Tensor]:
        length = points.norm(dim=-1)
        return length - self.radius, points / length[..., None]


def observation(rig: Any, radius: float, settings: HullSettings) -> InsideObservation:
    point = torch.zeros(1, 3, dtype=torch.float64)
    target = HullTarget(field=Ball(radius), points=point, normals=point, inner=point, depth=point[:, 0])
    return InsideObservation(target=target, vertices=SkinVertices.of(SkinPoints(rig.hand), settings))


def hands(rig: Any) -> PosedHands:
    poses = [rig.person(seed)[0] for seed in (1, 2)]
    return PosedHands(pose=HandPose.stack(poses), shape=rig.hand.shape)


def test_cost_is_hubers_of_the_distance_outside(rig: Any) -> None:
    settings = HullSettings(vertices=200, inside_weight=50.0, std_m=0.002)
    stage, both = Stage(gross_m=0.004), hands(rig)
    own = observation(rig, 0.07, settings)
    found = own.associate(both, stage).equations(both)
    distance = rig.vertices(both.pose)[:, own.vertices.index].norm(dim=-1) - 0.07
    away = distance.clamp_min(0) / 0.002
    loss = torch.where(away <= 3, away.square(), 2 * 3 * away - 9)
    torch.testing.assert_close(found.cost, 0.5 * 50 * (own.vertices.area_fraction * loss).sum(-1))
    assert bool((away > 3).any())
    assert bool((away == 0).any())


def test_slack_moves_the_surface(rig: Any) -> None:
    both, stage = hands(rig), Stage(gross_m=0.004)
    settings = HullSettings(vertices=100)
    moved = replace(settings, slack_m=0.01)
    loose, wide = (
        own.associate(both, stage).equations(both)
        for own in (observation(rig, 0.06, moved), observation(rig, 0.07, settings))
    )
    for name in ("cost", "gradient", "matrix"):
        torch.testing.assert_close(getattr(loose, name), getattr(wide, name))


def test_a_single_step_leaves_out_what_is_inside_and_is_the_same_step(rig: Any) -> None:
    own, both = observation(rig, 0.07, HullSettings(vertices=200)), hands(rig)
    one = PosedHands(pose=both.pose[:1], shape=both.shape)
    quick = own.associate(one, Stage(gross_m=0.004, method="gauss_newton"))
    whole = own.associate(one, Stage(gross_m=0.004))
    assert 0 < len(quick.index) < len(whole.index)
    for name in ("cost", "gradient", "matrix"):
        torch.testing.assert_close(getattr(quick.equations(one), name), getattr(whole.equations(one), name))


def test_what_is_told_are_shares_of_the_area(rig: Any) -> None:
    own, both = observation(rig, 0.07, HullSettings(vertices=10_000, near_m=0.003)), hands(rig)
    [explanation] = own.associate(both, Stage()).explained()
    distance = rig.vertices(both.pose).norm(dim=-1) - 0.07
    area = own.vertices.area_fraction
    order = own.vertices.index
    for found, limit in ((explanation.fraction, 0.003), (explanation.inside, 0.0)):
        expected = [float(area[(row[order] <= limit)].sum()) for row in distance]
        assert found is not None
        assert found.tolist() == pytest.approx(expected)
    assert 0.2 < float(explanation.fraction.min()) < 1
    expected = [float((row[order].clamp_min(0) * area).sum()) for row in distance]
    assert explanation.distance.tolist() == pytest.approx(expected)
