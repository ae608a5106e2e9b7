"""Skin outside a hull: values, derivatives against autograd, what is within does not count."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchhand.fit.hull.inside import hull_inside_residual


@dataclass(frozen=True)
class Ball:
    """The field of a ball about the origin."""

    radius: float

    def sample(self, points: Tensor, /) -> tuple[Tensor, Tensor]:
        length = points.norm(dim=-1)
        return length - self.radius, points / length[..., None]


def test_distance_outside_and_nothing_within(skin: Any) -> None:
    field = Ball(1.5)
    value, rows = hull_inside_residual(skin, field)
    outside = skin.points.norm(dim=-1) > 1.5
    assert 0.2 < float(outside.double().mean()) < 0.9
    assert torch.allclose(value, (skin.points.norm(dim=-1) - 1.5).clamp_min(0), atol=1e-15)
    assert bool((rows[~outside] == 0).all())
    assert float(rows[outside].abs().amax(-1).min()) > 0


def test_slack_moves_the_surface(skin: Any) -> None:
    loose, tight = (hull_inside_residual(skin, Ball(1.5), slack=slack)[0] for slack in (0.2, -0.2))
    assert torch.allclose(loose, hull_inside_residual(skin, Ball(1.7))[0], atol=1e-15)
    assert torch.allclose(tight, hull_inside_residual(skin, Ball(1.3))[0], atol=1e-15)


def test_derivative(skin: Any) -> None:
    field = Ball(1.5)

    def at(free: Tensor) -> Tensor:
        return hull_inside_residual(replace(skin, free=free), field)[0]

    exact = torch.func.jacrev(at)(skin.free)
    own = torch.stack([exact[hand, :, hand] for hand in range(3)])
    assert torch.allclose(hull_inside_residual(skin, field)[1], own, atol=1e-12)


def test_one_hand_never_touches_another(skin: Any) -> None:
    alone = replace(skin, start=skin.start[1:2], slopes=skin.slopes[1:2], free=skin.free[1:2])
    for both, own in zip(hull_inside_residual(skin, Ball(1.5)), hull_inside_residual(alone, Ball(1.5)), strict=True):
        assert torch.equal(both[1:2], own)
