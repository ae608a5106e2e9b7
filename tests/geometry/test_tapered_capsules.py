"""Depth of overlap of tapered capsules against dense sampling of both axes."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.geometry.tapered_capsules import tapered_capsule_depth


def _pairs(count: int, generator: torch.Generator, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    points = torch.randn(4, count, 3, generator=generator, dtype=torch.float64)
    radii = 0.6 * torch.rand(2, count, 2, generator=generator, dtype=torch.float64)
    return [x.to(dtype) for x in (points[0], points[1], radii[0], points[2], points[3], radii[1])]


def _sampled(a0: Tensor, a1: Tensor, ra: Tensor, b0: Tensor, b1: Tensor, rb: Tensor) -> Tensor:
    fraction = torch.linspace(0, 1, 401, dtype=torch.float64)
    p, q = (x[:, None] + fraction[:, None] * (y - x)[:, None] for x, y in ((a0, a1), (b0, b1)))
    r, t = (x[:, :1] + fraction * (x[:, 1:] - x[:, :1]) for x in (ra, rb))
    return (r[:, :, None] + t[:, None] - (p[:, :, None] - q[:, None]).norm(dim=-1)).amax((1, 2))


def test_against_sampling(generator: torch.Generator) -> None:
    """Never below the best sampled pair of balls, and above it by no more than the steps are wide."""
    pairs = _pairs(150, generator)
    pairs[4][:30] = pairs[3][:30] + 1.3 * (pairs[1] - pairs[0])[:30]  # parallel axes
    pairs[3][30:50] = pairs[0][30:50] + 0.4 * (pairs[1] - pairs[0])[30:50]  # axes that meet
    found, sampled = tapered_capsule_depth(*pairs), _sampled(*pairs)
    assert float((found - sampled).min()) > -1e-8
    assert float((found - sampled).max()) < 3e-3


def test_closed_cases() -> None:
    def depth(*points: tuple[float, ...]) -> float:
        return float(tapered_capsule_depth(*(torch.tensor(x, dtype=torch.float64) for x in points)))

    ball = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.5, 0.5))
    assert depth(*ball, (2.0, 0.0, 0.0), (2.0, 0.0, 0.0), (1.0, 1.0)) == pytest.approx(-0.5, abs=1e-9)
    bar = ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.2, 0.2))
    assert depth(*bar, (0.3, 0.3, -1.0), (0.3, 0.3, 1.0), (0.2, 0.2)) == pytest.approx(0.1)
    assert depth(*bar, (-1.0, 0.3, 0.0), (1.0, 0.3, 0.0), (0.2, 0.2)) == pytest.approx(0.1)
    # a ball beside a cone of half angle 30°: the gap is along the normal of the slanted surface
    cone = ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 2.0))
    assert depth(*cone, (1.0, 3.0, 0.0), (1.0, 3.0, 0.0), (0.1, 0.1)) == pytest.approx(
        0.1 - (3.0 * math.sqrt(1 - 0.25) - 1.0 * 0.5)
    )


def test_symmetric_and_rigid(generator: torch.Generator) -> None:
    pairs = _pairs(200, generator)
    depth = tapered_capsule_depth(*pairs)
    torch.testing.assert_close(tapered_capsule_depth(*pairs[3:], *pairs[:3]), depth, atol=1e-12, rtol=0)
    flipped = [pairs[1], pairs[0], pairs[2].flip(-1), *pairs[3:]]
    torch.testing.assert_close(tapered_capsule_depth(*flipped), depth, atol=1e-12, rtol=0)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches(generator: torch.Generator, batch: tuple[int, ...]) -> None:
    flat = _pairs(max(1, math.prod(batch)), generator)
    together = tapered_capsule_depth(*(x.reshape(*batch, x.shape[-1]) for x in flat))
    assert together.shape == batch
    loop = torch.stack([tapered_capsule_depth(*(x[i] for x in flat)) for i in range(len(flat[0]))])
    torch.testing.assert_close(together.flatten(), loop, atol=1e-15, rtol=0)


def test_derivatives(generator: torch.Generator) -> None:
    pairs = tuple(x.requires_grad_() for x in _pairs(30, generator))
    assert torch.autograd.gradcheck(tapered_capsule_depth, pairs)


def test_nothing_breaks_where_centres_meet() -> None:
    same = torch.zeros(3).requires_grad_()
    depth = tapered_capsule_depth(same, same + 1.0, torch.ones(2), same, same + 1.0, torch.ones(2))
    assert float(depth.detach()) == pytest.approx(2.0)
    (gradient,) = torch.autograd.grad(depth, same)
    assert bool(gradient.isfinite().all())


def test_float32_is_close(generator: torch.Generator) -> None:
    pairs = [0.1 * x for x in _pairs(500, generator)]
    single = tapered_capsule_depth(*(x.float() for x in pairs))
    torch.testing.assert_close(single.double(), tapered_capsule_depth(*pairs), atol=1e-6, rtol=0)
