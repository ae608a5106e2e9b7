"""Restarts of hands that leave much of a picture's contour unexplained: their fingers have settled on other fingers.

Where two fingers of the model lie on one of the picture, or one before the palm, no small step leads away. With the
palm where it was found, turned in the picture by somewhat more than half of what lies between two fingers, the fingers
of the start fall onto those that they belong to; or the fingers are put to where the likeliest postures have them.
"""

import math
from dataclasses import dataclass, replace

import torch

from torchhand.devices import read_back, rows_where
from torchhand.errors import require
from torchhand.fit import PostureResiduals, Problem, Schedule, Solutions, solve
from torchhand.fit.contour.observation import CONTOUR
from torchhand.fit.contour.settings import WIDE_SEARCH
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import HandPose

_ROOT = 6
_TURN_DEG = 8.0  # about the line of sight through the wrist, to either side; stretched fingers are some 12° apart
_SPREAD_DEG = 10.0  # standard deviation of the joint angles of starts, by which postures are judged


@dataclass(frozen=True, kw_only=True)
class RestartSettings:
    """When hands are started again, and how."""

    min_fraction: float = 0.93
    """Share of the picture's contour that a hand must explain not to be started again, 0 to 1; 0 starts none again. A
    finger that is left out is a tenth of the contour or more, where it does not lie beside another."""
    postures: int = 2
    """Number of likely postures that the fingers are put into; 0 to 100."""

    def __post_init__(self) -> None:
        require(0 <= self.min_fraction <= 1, "restarts.min_fraction", "0 to 1", self.min_fraction)
        require(0 <= self.postures <= 100, "restarts.postures", "0 to 100", self.postures)


@dataclass(frozen=True, kw_only=True)
class Restarts:
    """Where hands are started again."""

    settings: RestartSettings
    camera: Camera
    """Camera in whose picture hands are turned."""
    postures: PostureResiduals | None = None
    """Postures that are likely; None where none are known."""

    def beside(self, hands: HandPose, starts: HandPose) -> HandPose:
        """The starts (k) themselves, and others beside the hands that came of them: (several, k)."""
        begun, count = [starts], self.settings.postures
        ahead, place = self.camera.rotation.to(hands.dofs)[2], hands.normalized().dofs[:, :_ROOT]
        for turn in (math.radians(_TURN_DEG), -math.radians(_TURN_DEG)):
            dofs = torch.cat((place, starts.dofs[:, _ROOT:]), 1)
            begun.append(HandPose.of(dofs, rotation_from_vector(turn * ahead) @ hands.rotation))
        if self.postures is not None and count:
            known = self.postures.on(place.device).nearest(starts.dofs, math.radians(_SPREAD_DEG), count)
            begun += [HandPose.of(torch.cat((place, joints), 1), hands.rotation) for joints in known.unbind(1)]
        return HandPose.stack(begun)


def solve_with_restarts(
    problem: Problem, starts: HandPose, schedule: Schedule, restarts: Restarts, *, at_once: int = 128
) -> Solutions:
    """`solve`; hands that explain too little of the picture's contour are then solved from other starts as well.

    Restarts go through WIDE_SEARCH; the cheapest one of each hypothesis goes through those of the schedule that
    are finer (or its last), and is the result where it is cheaper than what was found before. One hypothesis never
    touches another.
    """
    found = solve(problem, starts, schedule, at_once=at_once)
    if not found.explained:
        return found
    batch, starts = starts.batch_shape, starts.to(problem.space.basis).reshape(-1)
    found = found.rows(slice(None))
    unexplained = found.explained_by(CONTOUR).fraction < restarts.settings.min_fraction
    poor = rows_where(read_back(unexplained), unexplained.device)
    if len(poor):
        begun = restarts.beside(found.pose[poor], starts[poor])
        kinds = len(begun)
        tried = solve(problem.rows(poor.repeat(kinds)), begun.reshape(-1), WIDE_SEARCH, at_once=at_once)
        cheapest = tried.cost.unflatten(0, (kinds, -1)).argmin(0)
        best = tried.rows(cheapest * len(poor) + torch.arange(len(poor), device=poor.device))
        finer = tuple(stage for stage in schedule if stage.gross_m < WIDE_SEARCH[-1].gross_m) or schedule[-1:]
        refined = solve(problem.rows(poor), best.pose, finer, at_once=at_once)
        spent = tried.iterations.unflatten(0, (kinds, -1)).sum(0) + refined.iterations
        found = replace(found, iterations=found.iterations.index_add(0, poor, spent)).or_cheaper(poor, refined)
    return found.reshape(batch)
