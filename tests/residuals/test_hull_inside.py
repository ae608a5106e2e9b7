"""Skin outside a hull: values, derivatives against autograd, what is within does not count."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchhand.residuals.hull_inside import hull_inside_residual


@dataclass(frozen=True)
class Ball:
    """The field of a ball about the origin."""

    radius: float

    def sample(self, points: Tensor, /) -> tuple[Tensor, Tensor]:
        length = points.norm(dim=-1)
        return length - self.radius, points / length[..., None]


@dataclass(frozen=True)
class Straight:
    """Points that move linearly with the free parameters."""

    start: Tensor
    slopes: Tensor
    """hands, points, 3, free"""
    free: Tensor

    @property
    def points(self) -> Tensor:
        return self.start + (self.slopes @ self.free[:, None, :, None]).squeeze(-1)

    def along(self, direction: Tensor) -> Tensor:
        return (direction[..., None, :] @ self.slopes).squeeze(-2)


def some(generator: torch.Generator, hands: int = 3, points: int = 40) -> Straight:
    def normal(*sizes: int) -> Tensor:
        return torch.randn(*sizes, generator=generator, dtype=torch.float64)

    return Straight(normal(hands, points, 3), normal(hands, points, 3, 4), 0.1 * normal(hands, 4))


def test_distance_outside_and_nothing_within(generator: torch.Generator) -> None:
    motion, field = some(generator), Ball(1.5)
    value, rows = hull_inside_residual(motion, field)
    outside = motion.points.norm(dim=-1) > 1.5
    assert 0.2 < float(outside.double().mean()) < 0.9
    assert torch.allclose(value, (motion.points.norm(dim=-1) - 1.5).clamp_min(0), atol=1e-15)
    assert bool((rows[~outside] == 0).all())
    assert float(rows[outside].abs().amax(-1).min()) > 0


def test_slack_moves_the_surface(generator: torch.Generator) -> None:
    motion = some(generator)
    loose, tight = (hull_inside_residual(motion, Ball(1.5), slack=slack)[0] for slack in (0.2, -0.2))
    assert torch.allclose(loose, hull_inside_residual(motion, Ball(1.7))[0], atol=1e-15)
    assert torch.allclose(tight, hull_inside_residual(motion, Ball(1.3))[0], atol=1e-15)


def test_derivative(generator: torch.Generator) -> None:
    motion, field = some(generator), Ball(1.5)

    def at(free: Tensor) -> Tensor:
        return hull_inside_residual(Straight(motion.start, motion.slopes, free), field)[0]

    exact = torch.func.jacrev(at)(motion.free)
    own = torch.stack([exact[hand, :, hand] for hand in range(3)])
    assert torch.allclose(hull_inside_residual(motion, field)[1], own, atol=1e-12)


def test_one_hand_never_touches_another(generator: torch.Generator) -> None:
    motion = some(generator)
    alone = Straight(motion.start[1:2], motion.slopes[1:2], motion.free[1:2])
    for both, own in zip(hull_inside_residual(motion, Ball(1.5)), hull_inside_residual(alone, Ball(1.5)), strict=True):
        assert torch.equal(both[1:2], own)
