"""Levenberg-Marquardt for many independent least-squares problems at once, within bounds."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import asks_after, read_back, rows_where
from torchhand.numerics.least_squares.box_step import flat_bounds
from torchhand.numerics.least_squares.damped_iteration import DampedIteration
from torchhand.numerics.least_squares.records import (
    LeastSquares,
    LevenbergMarquardtSettings,
    Linearisation,
    NormalEquations,
    Status,
    normal_equations,
)
from torchhand.numerics.least_squares.robust import RobustLoss
from torchhand.precision import full_precision

__all__ = [
    "LeastSquares",
    "LevenbergMarquardtSettings",
    "Linearise",
    "NormalEquations",
    "RobustLoss",
    "Status",
    "levenberg_marquardt",
]

_WORTH_DROPPING = 0.75  # problems that are done are dropped when no more than this share is left

Linearise = Callable[..., Linearisation]


@torch.no_grad()
@full_precision
def levenberg_marquardt(
    linearise: Linearise,
    start: Float[Tensor, "*batch n"],
    *,
    lower: Float[Tensor, "*#batch n"] | None = None,
    upper: Float[Tensor, "*#batch n"] | None = None,
    robust: RobustLoss | None = None,
    settings: LevenbergMarquardtSettings | None = None,
    takes_rows: bool = False,
    first: NormalEquations | None = None,
) -> LeastSquares:
    """Minimise ½ |r(x)|², or a robust loss of r, over x with lower <= x <= upper, for every problem of the batch.

    linearise(x (*batch, n)) returns the residuals (*batch, m) and their Jacobian (*batch, m, n), or `NormalEquations`
    (`robust` is then the caller's own affair). With `takes_rows`, it is called as linearise(x (k, n), rows (k,)) with
    the problems (of the flattened batch) that x belongs to, and problems that are done are not evaluated any more.

    Damping is Marquardt's, relative to the diagonal of JᵀJ, so the scales of the variables do not matter; every problem
    has its own. A step is taken only if it lowers the cost: the best values are always the present ones, and a trial
    with a NaN is a refused one. The start is put into the bounds first. One problem never touches another.

    On an accelerator the problems are asked every few turns only whether they are done (`torchhand.devices`).

    first: what linearise gives at the start, where that is known already and the start lies within the bounds.
    """
    settings = settings or LevenbergMarquardtSettings()
    batch, size = start.shape[:-1], start.shape[-1]
    low, high = flat_bounds(lower, upper, start)

    def evaluate(values: Tensor, rows: Tensor) -> NormalEquations:
        if takes_rows:
            return normal_equations(linearise(values, rows), robust)
        return _in_a_row(normal_equations(linearise(values.reshape(start.shape)), robust), size)

    values = start.reshape(-1, size)
    values = values.clone() if low is None else values.clamp(low, high)
    if first is None:
        first = evaluate(values, torch.arange(len(values), device=values.device))
    work = DampedIteration.begin(values, (low, high), _in_a_row(first, size), settings)
    done: list[DampedIteration] = []
    for turn in range(settings.iterations):
        work.propose(settings)
        if asks_after(turn, values.device):
            is_open = read_back(work.is_open)
            if not is_open.any():
                break
            if takes_rows and is_open.sum() <= _WORTH_DROPPING * len(is_open):
                done.append(work.select(rows_where(~is_open, values.device)))
                work = work.select(rows_where(is_open, values.device))
        work.accept_or_reject(evaluate(work.trial, work.rows), settings)
    done.append(work)
    whole = DampedIteration.joined(done)
    on_bound = torch.zeros_like(whole.values, dtype=torch.bool)
    if low is not None and high is not None:
        on_bound = (whole.values <= low) | (whole.values >= high)
    return LeastSquares(
        values=whole.values.reshape(start.shape),
        cost=whole.cost.reshape(batch),
        status=whole.status.reshape(batch),
        iterations=whole.iterations.reshape(batch),
        matrix=whole.matrix.reshape(*batch, size, size),
        gradient=whole.gradient.reshape(start.shape),
        on_bound=on_bound.reshape(start.shape),
    )


def _in_a_row(found: NormalEquations, size: int) -> NormalEquations:
    """The problems with one batch dimension."""
    return NormalEquations(
        matrix=found.matrix.reshape(-1, size, size),
        gradient=found.gradient.reshape(-1, size),
        cost=found.cost.reshape(-1),
    )
