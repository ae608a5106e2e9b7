"""Ways from sign to sign: nothing runs through anything, limits hold, the ends are the signs."""

import itertools
import random

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.hand import DOFS, JOINT_DOFS, Clearance
from torchhand.signs.file import load_signs
from torchhand.signs.table import HANDSHAPES, SIGNS
from torchhand.signs.transitions import RECIPES, choose_recipe, curve, sampled, waypoints

MODEL = load_hand_model()
KINEMATICS = MODEL.kinematics(dtype=torch.float64)
SOLVED = load_signs()
ALLOWED = 0.5e-3  # metres


def _way(clearance: Clearance, first: str, second: str, frames: int = 41) -> Tensor:
    recipe, _ = choose_recipe(clearance, first, second, SOLVED[first], SOLVED[second])
    points = waypoints(first, second, SOLVED[first], SOLVED[second], recipe)
    return clearance.separated(curve(points, torch.linspace(0, 1, frames, dtype=torch.float64)))


def _check(pairs: list[tuple[str, str]]) -> Tensor:
    clearance = Clearance(KINEMATICS)
    lower, upper = MODEL.skeleton.lower.double(), MODEL.skeleton.upper.double()
    deepest = []
    for first, second in pairs:
        way = _way(clearance, first, second)
        assert float((way[0] - SOLVED[first]).abs().max()) < 1e-9
        assert float((way[-1] - SOLVED[second]).abs().max()) < 1e-9
        assert bool(((way >= lower - 1e-9) & (way <= upper + 1e-9)).all())
        assert float(way.diff(dim=0).abs().max()) < 0.35, f"{first}{second}: jumps"
        deepest.append(clearance.worst(way).max())
    return torch.stack(deepest)


def test_some_ways() -> None:
    """A sample of the 36 x 35, with the hard ones: thumbs under fingers, crossed fingers, fists."""
    drawn = random.Random(0).sample([*itertools.permutations(SIGNS, 2)], 14)
    deepest = _check([*drawn, *(("R", "M"), ("T", "R"), ("N", "E"), ("S", "T"), ("D", "1"), ("I", "X"))])
    assert float(deepest.max()) <= ALLOWED


@pytest.mark.slow
def test_all_ways() -> None:
    own = {sign: next(s for s in SIGNS if HANDSHAPES[s] == HANDSHAPES[sign]) for sign in SIGNS}
    pairs = {(own[a], own[b]) for a, b in itertools.permutations(SIGNS, 2) if own[a] != own[b]}
    deepest = _check(sorted(pairs))
    above = [f"{a}{b} {1e3 * d:.2f}" for (a, b), d in zip(sorted(pairs), deepest.tolist(), strict=True) if d > ALLOWED]
    print(f"{len(pairs)} ways: {1e3 * float(deepest.max()):.2f} mm at most, above 0.5 mm: {', '.join(above) or 'none'}")
    assert float(deepest.max()) <= ALLOWED


def test_straight_ways_would_not_do() -> None:
    clearance = Clearance(KINEMATICS)
    straight = [sampled(torch.stack((SOLVED[a], SOLVED[b]))) for a, b in ("ST", "MR", "SM", "AN")]
    assert min(float(clearance.worst(way).max()) for way in straight) > 3e-3


def test_a_way_that_is_free_is_taken_straight() -> None:
    clearance = Clearance(KINEMATICS)
    recipe, depth = choose_recipe(clearance, "5", "L", SOLVED["5"], SOLVED["5"] * 0.98)
    assert (recipe, RECIPES[recipe].middle) == (0, False)
    assert depth < 0


def test_apart_moves_little_and_only_where_it_must() -> None:
    clearance = Clearance(KINEMATICS)
    free, deep = SOLVED["5"], SOLVED["S"].clone()
    deep[JOINT_DOFS.index("ring_mcp_aa")] -= 0.06
    deep[JOINT_DOFS.index("thumb_mcp_fe")] += 0.15
    before = clearance.worst(deep)
    assert float(before) > 1.5e-3
    moved = clearance.separated(torch.stack((free, deep, free)))
    assert torch.equal(moved[[0, 2]], torch.stack((free, free)))
    assert float(clearance.worst(moved[1])) < 0.3e-3
    assert float((moved[1] - deep).abs().max()) < 0.3
    assert torch.equal(clearance.separated(free[None]), free[None])


def test_depths_are_those_of_penetration_without_slack() -> None:
    from torchhand.hand import penetration, place_primitives, primitive_sizes

    shape = MODEL.shape_space.default.double() * 1.02
    pose = torch.zeros(2, len(DOFS), dtype=torch.float64)
    pose[:, 6:] = torch.stack((SOLVED["A"], SOLVED["R"]))
    primitives = place_primitives(KINEMATICS(pose, shape), primitive_sizes(MODEL.shape_space, shape))
    assert torch.equal(Clearance(KINEMATICS, shape).worst(pose[:, 6:]), penetration(primitives).depth.amax(-1))
