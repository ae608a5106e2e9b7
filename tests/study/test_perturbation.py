"""Perturbations of starts: their size, their spread, and that seeds tell them."""

import math

import pytest
import torch

from torchhand.hand import named_pose_space, pose_space
from torchhand.study.perturbation import PerturbationSettings, draw_perturbations, seed_of, spread_of_starts

SPACE = named_pose_space("dof26")
SETTINGS = PerturbationSettings(angle_deg=12.0, translation_mm=7.0, rotation_deg=20.0, levels=4)


def test_every_kind_keeps_to_its_largest(generator: torch.Generator) -> None:
    change = draw_perturbations(SPACE, torch.ones(4000).double(), SETTINGS, generator)
    turn = change[:, 3:6].norm(dim=-1)
    for part, largest in ((change[:, :3], 7e-3), (turn, math.radians(20)), (change[:, 6:], math.radians(12))):
        assert 0.98 * largest < float(part.abs().max()) <= largest
    # Uniform: the mean of the absolute values is half the largest.
    torch.testing.assert_close(turn.mean(), torch.tensor(math.radians(10)).double(), rtol=0.03, atol=0)
    torch.testing.assert_close(change[:, 6:].abs().mean(), torch.tensor(math.radians(6)).double(), rtol=0.03, atol=0)


def test_the_axis_has_any_direction(generator: torch.Generator) -> None:
    change = draw_perturbations(SPACE, torch.ones(20_000).double(), SETTINGS, generator)
    axis = torch.nn.functional.normalize(change[:, 3:6], dim=-1)
    torch.testing.assert_close(axis.T @ axis / len(axis), torch.eye(3).double() / 3, atol=0.01, rtol=0)


def test_size_scales_the_same_changes() -> None:
    size = torch.tensor([1.0, 0.5, 0.0]).double()
    whole, scaled = (
        draw_perturbations(SPACE, own, SETTINGS, torch.Generator().manual_seed(4))
        for own in (torch.ones_like(size), size)
    )
    torch.testing.assert_close(scaled, size[:, None] * whole)


def test_only_what_is_free_moves(generator: torch.Generator) -> None:
    space = pose_space("two", ("root_ty", "root_rz"))
    change = draw_perturbations(space, torch.ones(500).double(), SETTINGS, generator)
    low, high = change.amin(0), change.amax(0)
    limits = torch.tensor([7e-3, math.radians(20)]).double()
    assert bool((low < -0.95 * limits).all())  # a single axis is turned about either way
    assert bool((high > 0.95 * limits).all())
    assert bool((change.abs() <= limits).all())


@pytest.mark.parametrize("name", ["dof26", "planar_scale"])
def test_spread_is_that_of_the_draws(name: str, generator: torch.Generator) -> None:
    space = named_pose_space(name)
    change = draw_perturbations(space, torch.ones(20_000).double(), SETTINGS, generator)
    torch.testing.assert_close(spread_of_starts(space, SETTINGS), change.std(0), rtol=0.03, atol=0)


def test_nothing_is_expected_to_be_exact() -> None:
    settings = PerturbationSettings(angle_deg=0.0, rotation_deg=0.0)
    std = spread_of_starts(SPACE, settings)
    assert bool((std[3:] > 0).all())
    assert float(std[3:].max()) < 1e-3 < float(std[0])


def test_seeds_differ_with_every_part_and_stay_the_same() -> None:
    seeds = {seed_of(*parts) for parts in ((0, 1, 2), (0, 12), (0, 1), ("0", 1, 3), (-1, 1, 2), (1, 1, 2))}
    assert len(seeds) == 6
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert seed_of(0, 1, 2) == 4908529878518941816  # the first 8 bytes of SHA-256 of "0/1/2"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"angle_deg": -1.0}, "perturbation.angle_deg: expected 0 to 180, got -1.0"),
        ({"translation_mm": math.nan}, "perturbation.translation_mm: expected 0 to 1000, got nan"),
        ({"rotation_deg": 181.0}, "perturbation.rotation_deg: expected 0 to 180, got 181.0"),
        ({"levels": 0}, "perturbation.levels: expected 1 to 100, got 0"),
        ({"angle_deg": 0.0, "translation_mm": 0.0, "rotation_deg": 0.0}, "got three zeros"),
    ],
)
def test_mistakes_are_named(given: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PerturbationSettings(**given)  # pyright: ignore[reportArgumentType]
