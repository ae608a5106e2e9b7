"""The hull's surface against the skin: the nearest vertex by place and direction, distances and derivatives."""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchhand.fit.hull.covered import hull_covered_residual, match_hull


def test_match_is_the_nearest_in_place_and_direction(generator: torch.Generator) -> None:
    def normal(*sizes: int) -> Tensor:
        return torch.randn(*sizes, generator=generator, dtype=torch.float64)

    unit = torch.nn.functional.normalize
    hull, hull_normals = 0.05 * normal(30, 3) + 0.3, unit(normal(30, 3), dim=-1)
    skin, normals = 0.05 * normal(2, 50, 3) + 0.3, unit(normal(2, 50, 3), dim=-1)
    for turn in (0.0, 0.02):
        found = match_hull(hull, hull_normals, skin, normals, turn=turn)
        apart = (hull[:, None] - skin[:, None]).square().sum(-1)
        apart = apart + turn**2 * (hull_normals[:, None] - normals[:, None]).square().sum(-1)
        assert torch.equal(found, apart.argmin(-1))


def test_match_prefers_the_same_side_of_a_plate() -> None:
    """The surface lies 1 mm below the plate's upper side, nearer to its lower one: direction decides."""
    up = torch.tensor(((0.0, 0.0, 1.0),), dtype=torch.float64)
    plate = torch.tensor((((0.0, 0.0, 0.001), (0.0, 0.0, -0.0005)),), dtype=torch.float64)
    normals = torch.stack((up[0], -up[0]))[None]
    surface = torch.zeros(1, 3, dtype=torch.float64)
    assert match_hull(surface, up, plate, normals, turn=0.01).tolist() == [[0]]
    assert match_hull(surface, up, plate, normals, turn=0.0).tolist() == [[1]]


def test_points_that_are_not_finite_are_nobodys_match(generator: torch.Generator) -> None:
    skin = torch.randn(2, 20, 3, generator=generator, dtype=torch.float64)
    skin[0, 3], skin[1] = torch.nan, torch.nan
    normals = torch.nn.functional.normalize(skin, dim=-1)
    hull = torch.randn(15, 3, generator=generator, dtype=torch.float64)
    found = match_hull(hull, torch.nn.functional.normalize(hull, dim=-1), skin, normals, turn=0.01)
    assert not bool((found[0] == 3).any())
    assert bool(((found >= 0) & (found < 20)).all())


def test_covered_is_positive_where_skin_is_beyond(skin: Any) -> None:
    up = torch.tensor((((0.0, 0.0, 1.0),),), dtype=torch.float64)
    nothing = torch.zeros(1, 1, 3, 1, dtype=torch.float64)
    place = torch.tensor((((0.3, 0.1, 0.02),),), dtype=torch.float64)
    motion = replace(skin, start=place, slopes=nothing, free=nothing[:, 0, :1, 0])
    value, rows = hull_covered_residual(motion, torch.zeros(1, 3, dtype=torch.float64), up)
    assert float(value) == 0.02  # sliding sideways costs nothing
    assert float(rows) == 0


def test_derivative(skin: Any, generator: torch.Generator) -> None:
    normals = torch.nn.functional.normalize(torch.randn(3, 40, 3, generator=generator, dtype=torch.float64), dim=-1)
    surface = torch.randn(40, 3, generator=generator, dtype=torch.float64)

    def at(free: Tensor) -> Tensor:
        return hull_covered_residual(replace(skin, free=free), surface, normals)[0]

    exact = torch.func.jacrev(at)(skin.free)
    own = torch.stack([exact[hand, :, hand] for hand in range(3)])
    assert torch.allclose(hull_covered_residual(skin, surface, normals)[1], own, atol=1e-12)
