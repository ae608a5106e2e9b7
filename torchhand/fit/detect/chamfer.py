"""How well a drawn posture lies on a silhouette's outline: chamfer distance in both directions, and its refinement."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from torchhand.fit.detect.template import Template

_REACH = 0.5  # distances are cut off here, palm radii
_MIN_POINTS = 10  # outline points on the fingers' side of the wrist, below which nothing is believed
_ROUNDS = 10  # of the refinement
_FIRST_SHIFT, _FIRST_TURN, _FIRST_STRETCH = 0.25, 0.07, 0.08  # palm radii, radians, share of the radius
_SAME_TURN, _SAME_PLACE = 0.12, 0.25  # radians, palm radii: nearer candidates are one


@dataclass(frozen=True)
class Candidate:
    """A template laid over a silhouette."""

    cost: float
    template: Template
    centre: np.ndarray
    """Centre of the palm, (x, y) px."""
    radius: float
    """Radius of the palm, px."""
    angle: float
    """Angle from upright, radians, clockwise in the picture."""


def chamfer_costs(
    template: Template,
    distance: np.ndarray,
    edge: np.ndarray,
    centre: np.ndarray,
    sizes: np.ndarray,
    angles: np.ndarray,
    points: int,
) -> np.ndarray:
    """Cost (angles, sizes) of the template's edge on the picture's, and of the picture's on the template's.

    distance  of every pixel from the picture's outline, px
    edge      points (n, 2) of that outline, (x, y) px
    centre    of the palm, (x, y) px
    sizes     palm radii, px
    points    how many of the template's edge points are compared, about

    0 is perfect, 1 the worst: the mean of both directions of the mean distance, cut off at half a palm radius. Beyond
    the wrist neither side is compared.
    """
    turn = np.stack((np.cos(angles), -np.sin(angles), np.sin(angles), np.cos(angles)), -1).reshape(-1, 2, 2)
    model = thinned(template.edge, points)
    there = np.einsum("aij,nj->ani", turn, model)[:, None] * sizes[:, None, None] + centre
    # A point that falls outside the picture says nothing, but a hand that is mostly outside is not believed.
    forward = np.minimum(_lookup(distance, there, np.nan) / sizes[:, None], _REACH)
    seen = np.isfinite(forward)
    ahead = np.where(seen, forward, 0).sum(-1) / np.maximum(seen.sum(-1), 1)
    ahead = ahead + 0.5 * _REACH * (1 - seen.mean(-1))
    back = np.einsum("aji,nj->ani", turn, edge - centre)[:, None] / sizes[:, None, None]
    is_hand = back[..., 1] < template.wrist_y
    behind = _lookup(template.distance, back * template.pixels_per_radius + template.centre_px, _REACH)
    behind = np.minimum(behind, _REACH)
    backward = np.where(is_hand, behind, 0).sum(-1) / np.maximum(is_hand.sum(-1), 1)
    backward = np.where(is_hand.sum(-1) < _MIN_POINTS, _REACH, backward)
    return 0.5 * (ahead + backward) / _REACH


def refined(candidate: Candidate, distance: np.ndarray, edge: np.ndarray, points: int) -> Candidate:
    """Coordinate descent over place, angle and scale with shrinking steps; arguments as in `chamfer_costs`."""
    best = replace(candidate, cost=math.inf)
    shift, turn, stretch = _FIRST_SHIFT * candidate.radius, _FIRST_TURN, _FIRST_STRETCH
    for _ in range(_ROUNDS):
        moves = [(0, 0, 0.0, 1.0), (0, 0, turn, 1.0), (0, 0, -turn, 1.0), (0, 0, 0.0, 1 + stretch)]
        moves += [(0, 0, 0.0, 1 - stretch), (1, 0, 0.0, 1.0), (-1, 0, 0.0, 1.0), (0, 1, 0.0, 1.0), (0, -1, 0.0, 1.0)]
        trials = []
        for x, y, by, factor in moves:
            centre, radius, angle = best.centre + np.array((x, y)) * shift, best.radius * factor, best.angle + by
            cost = chamfer_costs(best.template, distance, edge, centre, np.array((radius,)), np.array((angle,)), points)
            trials.append(Candidate(float(cost[0, 0]), best.template, centre, radius, angle))
        winner = min(trials, key=lambda c: c.cost)
        if winner is trials[0]:
            shift, turn, stretch = 0.5 * shift, 0.5 * turn, 0.5 * stretch
        best = winner
    return best


def distinct(candidates: Iterable[Candidate], count: int) -> list[Candidate]:
    """The best candidates, best first, that differ in side, place or angle."""
    chosen: list[Candidate] = []
    for one in sorted(candidates, key=lambda c: c.cost):
        if all(_differs(one, other) for other in chosen):
            chosen.append(one)
        if len(chosen) == count:
            break
    return chosen


def thinned(points: np.ndarray, count: int) -> np.ndarray:
    """Every k-th point, so that at least `count` of more than so many remain."""
    return points[:: max(1, len(points) // count)]


def _differs(one: Candidate, other: Candidate) -> bool:
    turn = abs(math.remainder(one.angle - other.angle, 2 * math.pi))
    distance = float(np.hypot(*(one.centre - other.centre))) / max(one.radius, other.radius)
    return one.template.facing != other.template.facing or turn > _SAME_TURN or distance > _SAME_PLACE


def _lookup(grid: np.ndarray, points: np.ndarray, outside: float) -> np.ndarray:
    x, y = np.rint(points[..., 0]).astype(int), np.rint(points[..., 1]).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < grid.shape[1]) & (y < grid.shape[0])
    return np.where(inside, grid[np.where(inside, y, 0), np.where(inside, x, 0)], outside)
