"""Distances to the shapes that the hand's surface is blended from."""

import pytest
import torch
from torch import Tensor

pytest.importorskip("gpytoolbox", reason="building meshes needs torchhand[build]")

from torchhand.geometry import rotation_from_vector
from torchhand.modelling.distances import blended, ellipsoid, round_cone


def vector(*numbers: float) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


@pytest.mark.parametrize(("first", "second"), [(0.3, 0.3), (0.4, 0.15), (0.1, 0.35)])
def test_a_round_cone_is_the_hull_of_two_balls(first: float, second: float, generator: torch.Generator) -> None:
    start, end = vector(0.1, -0.2, 0.3), vector(0.5, 0.7, -0.1)
    points = 2 * torch.rand(300, 3, generator=generator, dtype=torch.float64) - 0.8
    fraction = torch.linspace(0, 1, 4001, dtype=torch.float64)[:, None]
    centres, radii = start + fraction * (end - start), first + fraction[:, 0] * (second - first)
    # The hull is the union of the balls in between.
    expected = (torch.cdist(points, centres) - radii).amin(-1)
    found = round_cone(points, start, end, vector(first)[0], vector(second)[0])
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)


def test_an_ellipsoid_is_exact_on_its_surface_and_first_order_near_it(generator: torch.Generator) -> None:
    axes, centre = vector(0.3, 0.5, 0.2), vector(0.1, 0.2, 0.3)
    turn = rotation_from_vector(vector(0.3, -0.5, 0.8))
    direction = torch.nn.functional.normalize(torch.randn(100, 3, generator=generator, dtype=torch.float64), dim=-1)
    surface = centre + (direction * axes) @ turn.T
    assert float(ellipsoid(surface, centre, turn, axes).abs().max()) < 1e-12
    normal = torch.nn.functional.normalize((direction / axes) @ turn.T, dim=-1)
    for step in (1e-4, -1e-4):
        found = ellipsoid(surface + step * normal, centre, turn, axes)
        torch.testing.assert_close(found, torch.full_like(found, step), atol=3e-7, rtol=0)


def test_a_blend_is_a_union_with_a_fillet() -> None:
    a, b = torch.linspace(-1, 1, 41, dtype=torch.float64), vector(0.2)
    whole = blended(a, b, 0.3)
    far = (a - b).abs() >= 0.3
    torch.testing.assert_close(whole[far], torch.minimum(a, b.expand_as(a))[far], atol=0, rtol=0)
    assert bool((whole <= torch.minimum(a, b.expand_as(a)) + 1e-15).all())
    torch.testing.assert_close(blended(b, b, 0.3), b - 0.075, atol=1e-15, rtol=0)
    torch.testing.assert_close(blended(a, b.expand_as(a), 0.3), blended(b.expand_as(a), a, 0.3), atol=0, rtol=0)
    x = a.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda t: blended(t, b, 0.3), (x,))
