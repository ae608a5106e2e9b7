"""From one sign to the next without the digits running through each other: by way of opened hands where needed.

A path is named by a recipe: which digits open first, which arrive last, and how far they open. The recipes are tried
from the shortest on; the first on which the parts hardly overlap is taken, else the one with least overlap.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import JOINT_DOFS, Clearance
from torchhand.numerics import monotone_cubic
from torchhand.signs.table import HANDSHAPES

_THUMB = torch.tensor([dof.startswith("thumb") for dof in JOINT_DOFS])

Stage = Literal["thumb", "fingers", "both"]
"""What is open at one via-pose: the thumb alone, the fingers alone, all."""


@dataclass(frozen=True)
class Recipe:
    """A way from one posture to another by way of open ones."""

    leaving: Stage | None
    """Digits that have opened at the first via-pose; the rest is still as in the first sign."""
    middle: bool
    """Whether the way has a via-pose in which all moving digits are open."""
    arriving: Stage | None
    """Digits that are still open at the last via-pose; the rest is as in the second sign already."""
    thumb: int = 0
    """Index into OPEN_THUMBS."""
    fingers: int = 0
    """Index into OPEN_FINGERS."""


OPEN_THUMBS: tuple[dict[str, float], ...] = (
    {"thumb_cmc_fe": 0.0, "thumb_cmc_aa": 45.0, "thumb_mcp_fe": 5.0, "thumb_ip_fe": 5.0},
    {"thumb_cmc_fe": -18.0, "thumb_cmc_aa": 30.0, "thumb_mcp_fe": -5.0, "thumb_ip_fe": 0.0},
    {"thumb_cmc_fe": 20.0, "thumb_cmc_aa": 58.0, "thumb_mcp_fe": 5.0, "thumb_ip_fe": 10.0},
)
"""Degrees."""
OPEN_FINGERS: tuple[tuple[float, float, float], ...] = ((40.0, 45.0, 30.0), (15.0, 20.0, 13.0), (0.0, 5.0, 3.0))
"""Flexion of MCP, PIP and DIP joints, degrees."""
_OPEN_SPREAD_DEG = {"index_mcp_aa": 8.0, "ring_mcp_aa": 6.0, "little_mcp_aa": 13.0}

_DIRECT = Recipe(None, False, None)
_STAGES: tuple[tuple[Stage | None, bool, Stage | None], ...] = (
    ("thumb", False, "thumb"),
    (None, True, None),
    ("thumb", True, None),
    (None, True, "thumb"),
    ("fingers", True, None),
    (None, True, "fingers"),
    ("thumb", True, "thumb"),
    ("fingers", True, "thumb"),
    ("thumb", True, "fingers"),
    ("fingers", True, "fingers"),
)
RECIPES: tuple[Recipe, ...] = (
    _DIRECT,
    *(
        Recipe(*stages, thumb=thumb, fingers=fingers)
        for stages in _STAGES
        for thumb in range(len(OPEN_THUMBS))
        for fingers in range(len(OPEN_FINGERS) if stages[1] else 1)
    ),
)
"""All ways, the shorter ones first."""

GOOD_ENOUGH = 1.2e-3
"""Overlap with which the search ends, metres: so much `Clearance.separated` takes away without a trace."""
_SAMPLES_PER_SEGMENT = 12
_TRIED_AT_ONCE = 10
_UNCROSSED_DEG = {"index_mcp_fe": 32.0, "index_mcp_aa": 12.0, "middle_mcp_aa": -8.0, "middle_mcp_fe": 0.0}


def choose_recipe(
    clearance: Clearance, first: str, second: str, start: Float[Tensor, "30"], end: Float[Tensor, "30"]
) -> tuple[int, float]:
    """The number of the recipe to take between two signs, and the deepest overlap on the way, metres.

    The first one whose overlap is at most GOOD_ENOUGH, or else the one with least.
    """
    best, lowest = 0, math.inf
    for chunk in range(0, len(RECIPES), _TRIED_AT_ONCE):
        numbers = range(chunk, min(chunk + _TRIED_AT_ONCE, len(RECIPES)))
        paths = [sampled(waypoints(first, second, start, end, number)) for number in numbers]
        depths = clearance.worst(torch.cat(paths)).split([len(path) for path in paths])
        for number, depth in zip(numbers, depths, strict=True):
            worst = float(depth.max())
            if worst <= GOOD_ENOUGH:
                return number, worst
            if worst < lowest:
                best, lowest = number, worst
    return best, lowest


def waypoints(
    first: str, second: str, start: Float[Tensor, "30"], end: Float[Tensor, "30"], recipe: int
) -> Float[Tensor, "points 30"]:
    """Joint angles from start to end, both included, by way of a recipe's open hands."""
    how = RECIPES[recipe]
    points = [start]
    out, into = start, end
    if HANDSHAPES[first].crossed:
        out = _uncrossed(start)
        points.append(out)
    if HANDSHAPES[second].crossed:
        into = _uncrossed(end)
    open_hand = _open_hand(how)
    if how.leaving is not None:
        points.append(_mixed(out, open_hand, how.leaving))
    if how.middle:
        points.append(open_hand)
    if how.arriving is not None:
        points.append(_mixed(into, open_hand, how.arriving))
    if HANDSHAPES[second].crossed:
        points.append(into)
    return torch.stack([*points, end])


def curve(points: Float[Tensor, "points 30"], fraction: Float[Tensor, "places"]) -> Float[Tensor, "places 30"]:
    """The eased curve through the points, evenly spread in time, at shares of the whole, 0 to 1."""
    segments = len(points) - 1
    return monotone_cubic(torch.arange(segments + 1, dtype=points.dtype), points, segments * fraction)


def sampled(points: Float[Tensor, "points 30"]) -> Float[Tensor, "places 30"]:
    """The curve at places close enough to judge it by."""
    count = _SAMPLES_PER_SEGMENT * (len(points) - 1) + 1
    return curve(points, torch.linspace(0, 1, count, dtype=points.dtype))


def _mixed(closed: Tensor, open_hand: Tensor, opened: Stage) -> Tensor:
    if opened == "both":
        return open_hand
    return torch.where(_THUMB if opened == "thumb" else ~_THUMB, open_hand, closed)


def _open_hand(how: Recipe) -> Float[Tensor, "30"]:
    angles = dict.fromkeys(JOINT_DOFS, 0.0) | OPEN_THUMBS[how.thumb] | _OPEN_SPREAD_DEG
    for finger in ("index", "middle", "ring", "little"):
        for joint, degrees in zip(("mcp", "pip", "dip"), OPEN_FINGERS[how.fingers], strict=True):
            angles[f"{finger}_{joint}_fe"] = degrees
    return torch.deg2rad(torch.tensor([angles[dof] for dof in JOINT_DOFS], dtype=torch.float64))


def _uncrossed(crossed: Float[Tensor, "30"]) -> Float[Tensor, "30"]:
    """Index and middle finger moved apart, the index still in front."""
    found = crossed.clone()
    for dof, degrees in _UNCROSSED_DEG.items():
        found[JOINT_DOFS.index(dof)] = math.radians(degrees)
    return found
