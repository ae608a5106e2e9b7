"""The state of many damped Gauss-Newton iterations: propose a step for each problem, accept or reject it, drop what is
done."""

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor

from torchhand.numerics.least_squares.box_step import after_box_step, damped_box_step
from torchhand.numerics.least_squares.records import LevenbergMarquardtSettings, NormalEquations, Status

_ACCEPTED_FRACTION = 1e-4  # of the predicted decrease
_GOOD_FRACTION, _POOR_FRACTION = 0.75, 0.25
_LOOSEN, _KEEP, _TIGHTEN = 0.1, 0.5, 2.0  # damping times this after a good, fair or poor step
_REFUSED = 4.0  # after a refused one, doubled with every further one
_MIN_DAMPING = 1e-12
_DAMPING_OF_GAUSS_NEWTON = 1.0  # a small step counts as convergence only where no more damping than this made it small
_ROUNDING = 8.0  # tolerances below this many units of rounding mean nothing


@dataclass(kw_only=True)
class DampedIteration:
    """Where the problems under way stand; every tensor has one row per problem."""

    rows: Tensor
    low: Tensor | None
    high: Tensor | None
    """Bounds of the values, both or neither."""
    values: Tensor
    matrix: Tensor
    gradient: Tensor
    cost: Tensor
    damping: Tensor
    factor: Tensor
    """Factor by which a refused step multiplies the damping."""
    status: Tensor
    is_open: Tensor
    iterations: Tensor
    trial: Tensor
    promised: Tensor
    """Decrease of the cost that the model predicts for the trial."""

    @classmethod
    def begin(
        cls,
        values: Tensor,
        bounds: tuple[Tensor | None, Tensor | None],
        first: NormalEquations,
        settings: LevenbergMarquardtSettings,
    ) -> "DampedIteration":
        is_sound = _is_finite(first)
        zero = torch.zeros_like(first.cost)
        status = torch.where(is_sound, Status.STALLED.value, Status.FAILED.value)
        rows = torch.arange(len(values), device=values.device)
        low, high = bounds
        return cls(
            rows=rows,
            low=low,
            high=high,
            values=values,
            matrix=first.matrix,
            gradient=first.gradient,
            cost=first.cost,
            damping=torch.full_like(zero, settings.damping),
            factor=torch.full_like(zero, _REFUSED),
            status=status,
            is_open=is_sound,
            iterations=torch.zeros_like(rows),
            trial=values.clone(),
            promised=zero,
        )

    def propose(self, settings: LevenbergMarquardtSettings) -> None:
        """Find the next trial of every open problem; those that have arrived are closed."""
        rooms = (None if bound is None else bound - self.values for bound in (self.low, self.high))
        step, is_solved = damped_box_step(self.matrix, self.gradient, self.damping, *rooms)
        pull = torch.add(self.gradient, (self.matrix @ step[..., None]).squeeze(-1), alpha=0.5)
        promised = -(step * pull).sum(-1)
        length = step.norm(dim=-1)
        rounding = _ROUNDING * torch.finfo(step.dtype).eps
        is_small = length <= max(settings.step_tolerance, rounding) * self.values.norm(dim=-1)
        is_small |= promised <= max(settings.cost_tolerance, rounding) * self.cost
        # A zero step at high damping: every variable is held by its bound.
        arrived = is_solved & ((is_small & (self.damping <= _DAMPING_OF_GAUSS_NEWTON)) | (length == 0))
        arrived = self.is_open & (arrived | (self.cost <= settings.cost_floor))
        self.status = self.status.masked_fill(arrived, Status.CONVERGED.value)
        self.is_open = self.is_open & ~arrived & (self.damping <= settings.max_damping)
        if self.low is None or self.high is None:
            trial = self.values + step
        else:
            trial = after_box_step(self.values, step, self.low, self.high)
        self.trial = torch.where((self.is_open & is_solved)[:, None], trial, self.values)
        self.promised = promised.masked_fill(~is_solved, torch.inf)

    def accept_or_reject(self, found: NormalEquations, settings: LevenbergMarquardtSettings) -> None:
        """Take the trials that lower the cost, and set the damping."""
        fraction = (self.cost - found.cost) / self.promised
        better = self.is_open & _is_finite(found) & (found.cost < self.cost) & (fraction >= _ACCEPTED_FRACTION)
        refused = self.is_open & ~better
        self.iterations += self.is_open
        change = torch.full_like(fraction, _TIGHTEN)
        change = torch.where(fraction > _POOR_FRACTION, _KEEP, change)
        change = torch.where(fraction > _GOOD_FRACTION, _LOOSEN, change)
        change = torch.where(better, change, torch.where(refused, self.factor, 1.0))
        self.damping = (self.damping * change).clamp_min(_MIN_DAMPING)
        self.factor = torch.where(better, _REFUSED, torch.where(refused, 2 * self.factor, self.factor))
        self.values = torch.where(better[:, None], self.trial, self.values)
        self.gradient = torch.where(better[:, None], found.gradient, self.gradient)
        self.cost = torch.where(better, found.cost, self.cost)
        self.matrix = torch.where(better[:, None, None], found.matrix, self.matrix)

    def select(self, chosen: Tensor) -> "DampedIteration":
        """The given problems."""

        def own(name: str) -> Any:
            value = getattr(self, name)
            return None if value is None else value[chosen]

        return DampedIteration(**{field.name: own(field.name) for field in fields(self)})

    @classmethod
    def joined(cls, parts: list["DampedIteration"]) -> "DampedIteration":
        """All problems again, in their first order."""
        if len(parts) == 1:
            return parts[0]
        order = torch.cat([part.rows for part in parts]).argsort()

        def whole(name: str) -> Any:
            values = [getattr(part, name) for part in parts]
            return None if values[0] is None else torch.cat(values)[order]

        return cls(**{field.name: whole(field.name) for field in fields(cls)})


def _is_finite(found: NormalEquations) -> Tensor:
    # A sum is finite only if all its terms are: one pass, no mask of the size of the matrix.
    return (found.cost + found.gradient.sum(-1) + found.matrix.sum((-2, -1))).isfinite()
