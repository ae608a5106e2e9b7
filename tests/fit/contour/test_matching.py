"""Which model point a boundary point belongs to: against all distances, hand by hand."""

import pytest
import torch
from torch import Tensor

from torchhand.fit.contour.matching import match_boundary
from torchhand.image import Boundary


def directions(generator: torch.Generator, *size: int) -> Tensor:
    return torch.nn.functional.normalize(torch.randn(*size, 2, generator=generator, dtype=torch.float64), dim=-1)


@pytest.mark.parametrize("turn_px", [15.0, 0.4, torch.tensor((15.0, 0.4), dtype=torch.float64)])
def test_matching_is_the_nearest_in_place_and_direction(turn_px: float | Tensor, generator: torch.Generator) -> None:
    """The side of a finger goes to the same side. A turn may be worth something else for every hand."""
    points = 100 * torch.rand(2, 60, 2, generator=generator, dtype=torch.float64)
    normals, own = directions(generator, 2, 60), directions(generator, 30)
    boundary = Boundary(points_px=100 * torch.rand(30, 2, generator=generator).double(), normals=own)
    usable = torch.rand(2, 60, generator=generator) < 0.5
    found = match_boundary(boundary, points, normals, usable, turn_px=turn_px)
    worth = torch.as_tensor(turn_px, dtype=torch.float64).expand(2)[:, None, None].square()
    distance = (boundary.points_px[:, None] - points[:, None]).square().sum(-1)
    distance = distance + worth * (own[:, None] - normals[:, None]).square().sum(-1)
    distance = torch.where(usable[:, None], distance, torch.inf)
    assert torch.equal(found, distance.argmin(-1))
    usable[1] = False
    assert bool((match_boundary(boundary, points, normals, usable, turn_px=turn_px)[1] == -1).all())


def test_hands_that_are_not_finite_match_nothing_and_harm_none(generator: torch.Generator) -> None:
    points = 100 * torch.rand(2, 40, 2, generator=generator, dtype=torch.float64)
    normals, own = directions(generator, 2, 40), directions(generator, 20)
    boundary = Boundary(points_px=100 * torch.rand(20, 2, generator=generator).double(), normals=own)
    usable = torch.ones(2, 40, dtype=torch.bool)
    turn = torch.tensor((8.0, torch.nan), dtype=torch.float64)
    alone = match_boundary(boundary, points[:1], normals[:1], usable[:1], turn_px=8.0)
    points[1], usable[1] = torch.nan, False
    found = match_boundary(boundary, points, normals, usable, turn_px=turn)
    assert torch.equal(found[:1], alone)
    assert bool((found[1] == -1).all())
