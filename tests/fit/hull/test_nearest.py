"""The nearest vertices of the skin by place and direction."""

import pytest
import torch
from torch import Tensor

from torchhand.fit.hull.nearest import match_hull, nearest_columns


def test_match_is_the_nearest_in_place_and_direction(generator: torch.Generator) -> None:
    def normal(*sizes: int) -> Tensor:
        return torch.randn(*sizes, generator=generator, dtype=torch.float64)

    unit = torch.nn.functional.normalize
    hull, hull_normals = 0.05 * normal(30, 3) + 0.3, unit(normal(30, 3), dim=-1)
    skin, normals = 0.05 * normal(2, 50, 3) + 0.3, unit(normal(2, 50, 3), dim=-1)
    for turn in (0.0, 0.02):
        found = match_hull(hull, hull_normals, skin, normals, turn=turn)
        distance = (hull[:, None] - skin[:, None]).square().sum(-1)
        distance = distance + turn**2 * (hull_normals[:, None] - normals[:, None]).square().sum(-1)
        assert torch.equal(found, distance.argmin(-1))


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


def test_hands_one_by_one_are_those_of_a_batch(generator: torch.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = torch.randn(2, 30, 5, generator=generator)
    points = torch.randn(4, 2, 5, 60, generator=generator)
    found = nearest_columns(wanted, points)
    monkeypatch.setattr("torchhand.fit.hull.nearest.is_host", lambda device: False)
    assert torch.equal(nearest_columns(wanted, points), found)
