"""Levenberg-Marquardt for many independent least-squares problems at once, within bounds."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.numerics.box_step import damped_box_step
from torchhand.numerics.robust import RobustLoss

_ACCEPTED_SHARE = 1e-4  # of the predicted decrease
_GOOD_SHARE, _POOR_SHARE = 0.75, 0.25
_LOOSEN, _KEEP, _TIGHTEN = 0.1, 0.5, 2.0  # damping times this after a good, fair or poor step
_REFUSED = 4.0  # after a refused one, doubled with every further one
_LEAST_DAMPING = 1e-12
_DAMPING_OF_GAUSS_NEWTON = 1.0  # a small step counts as convergence only where no more damping than this made it small
_ROUNDING = 8.0  # tolerances below this many units of rounding mean nothing
_WORTH_DROPPING = 0.75  # problems that are done are dropped when no more than this share is left


class Status(IntEnum):
    """How a problem ended; each problem of a batch has its own."""

    CONVERGED = 0
    """No step promises a noticeable decrease."""
    STALLED = 1
    """Out of iterations, or no step lowers the cost although the model promises it: the best values found."""
    FAILED = 2
    """The cost is not a number at the start: the start's values."""


@dataclass(frozen=True, kw_only=True)
class LevenbergMarquardtSettings:
    """When to stop, and the first damping."""

    iterations: int = 50
    """Most evaluations after that at the start; 1 or more."""
    damping: float = 1e-3
    """At the start, relative to the diagonal of JᵀJ; above 0."""
    most_damping: float = 1e8
    """Where no step lowers the cost up to this damping, the problem has stalled; above `damping`."""
    cost_tolerance: float = 1e-12
    """Converged when the predicted decrease is at most this share of the cost; 0 or more."""
    step_tolerance: float = 1e-9
    """Converged when a step is at most this share of the length of the values; 0 or more."""
    cost_floor: float = 0.0
    """Converged when the cost is at most this; 0 or more."""

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"iterations: expected 1 or more, got {self.iterations!r}")
        if not 0 < self.damping < self.most_damping < float("inf"):
            raise ValueError(
                "damping: expected above 0 and below most_damping, both finite,"
                f" got {self.damping!r} and {self.most_damping!r}"
            )
        for name in ("cost_tolerance", "step_tolerance", "cost_floor"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"{name}: expected 0 or more and finite, got {getattr(self, name)!r}")


@dataclass(frozen=True, kw_only=True)
class NormalEquations:
    """A cost and its quadratic model cost + gradient · d + ½ dᵀ matrix d, for callers that know a faster way to it."""

    matrix: Float[Tensor, "*batch n n"]
    """JᵀJ, or another positive semi-definite approximation of the second derivative."""
    gradient: Float[Tensor, "*batch n"]
    """Jᵀr; must be the exact derivative of the cost."""
    cost: Float[Tensor, "*batch"]
    """½ rᵀr"""


@dataclass(frozen=True, kw_only=True)
class LeastSquares:
    """What came out, problem by problem."""

    values: Float[Tensor, "*batch n"]
    """The best found, within the bounds."""
    cost: Float[Tensor, "*batch"]
    """Half the sum of squares (or the robust loss) there."""
    status: Int[Tensor, "*batch"]
    """Numbers of `Status`."""
    iterations: Int[Tensor, "*batch"]
    """Evaluations after that at the start."""
    matrix: Float[Tensor, "*batch n n"]
    """JᵀWJ at the values; its inverse is their covariance where residuals are in units of their standard deviation."""
    gradient: Float[Tensor, "*batch n"]
    """JᵀWr at the values."""
    on_bound: Bool[Tensor, "*batch n"]
    """Values that lie on a bound."""

    def rows(self, rows: Int[Tensor, "k"]) -> "LeastSquares":
        """The given problems of a batch with one dimension."""
        return LeastSquares(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    @property
    def converged(self) -> Bool[Tensor, "*batch"]:
        return self.status == Status.CONVERGED


Linearisation = tuple[Tensor, Tensor] | NormalEquations
Linearise = Callable[..., Linearisation]


@torch.no_grad()
def levenberg_marquardt(
    linearise: Linearise,
    start: Float[Tensor, "*batch n"],
    *,
    lower: Float[Tensor, "*#batch n"] | None = None,
    upper: Float[Tensor, "*#batch n"] | None = None,
    robust: RobustLoss | None = None,
    settings: LevenbergMarquardtSettings | None = None,
    takes_rows: bool = False,
) -> LeastSquares:
    """Minimise ½ |r(x)|², or a robust loss of r, over x with lower <= x <= upper, for every problem of the batch.

    linearise(x (*batch, n)) returns the residuals (*batch, m) and their Jacobian (*batch, m, n), or `NormalEquations`
    (`robust` is then the caller's own affair). With `takes_rows`, it is called as linearise(x (k, n), rows (k,)) with
    the problems (of the flattened batch) that x belongs to, and problems that are done are not evaluated any more.

    Damping is Marquardt's, relative to the diagonal of JᵀJ, so the scales of the variables do not matter; every problem
    has its own. A step is taken only if it lowers the cost: the best values are always the present ones, and a trial
    with a NaN is a refused one. The start is put into the bounds first. One problem never touches another.
    """
    settings = settings or LevenbergMarquardtSettings()
    if (lower is None) != (upper is None):
        raise ValueError("bounds: expected both or neither; use infinities")
    batch, size = start.shape[:-1], start.shape[-1]
    low = None if lower is None else lower.to(start).expand(*batch, size).reshape(-1, size)
    high = None if upper is None else upper.to(start).expand(*batch, size).reshape(-1, size)
    if low is not None and high is not None and not bool((low <= high).all()):
        raise ValueError("bounds: expected lower <= upper")

    def evaluate(values: Tensor, rows: Tensor) -> NormalEquations:
        if takes_rows:
            return _normal_equations(linearise(values, rows), robust)
        found = _normal_equations(linearise(values.reshape(start.shape)), robust)
        return NormalEquations(
            matrix=found.matrix.reshape(-1, size, size),
            gradient=found.gradient.reshape(-1, size),
            cost=found.cost.reshape(-1),
        )

    values = start.reshape(-1, size)
    values = values.clone() if low is None else values.clamp(low, high)
    rows = torch.arange(len(values), device=values.device)
    work = _Work.begin(values, rows, evaluate(values, rows), settings)
    done: list[_Work] = []
    for _ in range(settings.iterations):
        work.propose(low, high, settings)
        left = work.is_open.nonzero()[:, 0]
        if not len(left):
            break
        if takes_rows and len(left) <= _WORTH_DROPPING * len(work.rows):
            done.append(work.select((~work.is_open).nonzero()[:, 0]))
            work = work.select(left)
        work.judge(evaluate(work.trial, work.rows), settings)
    done.append(work)
    whole = _Work.joined(done)
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


def _normal_equations(found: Linearisation, robust: RobustLoss | None) -> NormalEquations:
    if isinstance(found, NormalEquations):
        return found
    residual, jacobian = found
    if robust is None:
        cost, weighted = 0.5 * residual.square().sum(-1), jacobian
    else:
        cost, weight = robust.cost_and_weights(residual)
        weighted = weight[..., None] * jacobian
    gradient = (weighted.mT @ residual[..., None]).squeeze(-1)
    return NormalEquations(matrix=weighted.mT @ jacobian, gradient=gradient, cost=cost)


@dataclass(kw_only=True)
class _Work:
    """Where the problems under way stand; every tensor has one row per problem."""

    rows: Tensor
    values: Tensor
    matrix: Tensor
    gradient: Tensor
    cost: Tensor
    damping: Tensor
    factor: Tensor
    """The damping after a refused step."""
    status: Tensor
    is_open: Tensor
    iterations: Tensor
    trial: Tensor
    promised: Tensor
    """Decrease of the cost that the model predicts for the trial."""

    @classmethod
    def begin(
        cls, values: Tensor, rows: Tensor, first: NormalEquations, settings: LevenbergMarquardtSettings
    ) -> "_Work":
        is_sound = _is_finite(first)
        zero = torch.zeros_like(first.cost)
        status = torch.where(is_sound, Status.STALLED.value, Status.FAILED.value)
        return cls(
            rows=rows,
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

    def propose(self, low: Tensor | None, high: Tensor | None, settings: LevenbergMarquardtSettings) -> None:
        """Find the next trial of every open problem; those that have arrived are closed."""
        chosen = self.is_open.nonzero()[:, 0]
        whole = len(chosen) == len(self.rows)
        matrix, gradient, damping, values = (
            tensor if whole else tensor[chosen] for tensor in (self.matrix, self.gradient, self.damping, self.values)
        )
        below, above = (None if bound is None else bound[self.rows[chosen]] for bound in (low, high))
        rooms = [None if bound is None else bound - values for bound in (below, above)]
        step, is_solved = damped_box_step(matrix, gradient, damping, *rooms)
        curvature = (step * (matrix @ step[..., None]).squeeze(-1)).sum(-1)
        promised = -(gradient * step).sum(-1) - 0.5 * curvature
        cost = self.cost[chosen]
        length = step.norm(dim=-1)
        rounding = _ROUNDING * torch.finfo(cost.dtype).eps
        is_small = length <= max(settings.step_tolerance, rounding) * values.norm(dim=-1)
        is_small = (is_small | (promised <= max(settings.cost_tolerance, rounding) * cost)) & is_solved
        arrived = (is_small & (damping <= _DAMPING_OF_GAUSS_NEWTON)) | (cost <= settings.cost_floor)
        # A zero step at high damping: every variable is held by its bound.
        arrived |= is_solved & (length == 0)
        self.status[chosen[arrived]] = Status.CONVERGED.value
        self.is_open[chosen[arrived | (damping > settings.most_damping)]] = False
        trial = values + step if below is None else (values + step).clamp(below, above)
        self.trial[chosen] = torch.where(is_solved[:, None], trial, values)
        self.promised[chosen] = torch.where(is_solved, promised, torch.inf)
        closed = (~self.is_open).nonzero()[:, 0]
        self.trial[closed] = self.values[closed]

    def judge(self, found: NormalEquations, settings: LevenbergMarquardtSettings) -> None:
        """Take the trials that lower the cost, and set the damping."""
        share = (self.cost - found.cost) / self.promised
        better = self.is_open & _is_finite(found) & (found.cost < self.cost) & (share >= _ACCEPTED_SHARE)
        refused = self.is_open & ~better
        self.iterations += self.is_open
        change = torch.full_like(share, _TIGHTEN)
        change = torch.where(share > _POOR_SHARE, _KEEP, change)
        change = torch.where(share > _GOOD_SHARE, _LOOSEN, change)
        change = torch.where(better, change, torch.where(refused, self.factor, 1.0))
        self.damping = (self.damping * change).clamp_min(_LEAST_DAMPING)
        self.factor = torch.where(better, _REFUSED, torch.where(refused, 2 * self.factor, self.factor))
        if bool(better.all()):
            self.values, self.matrix, self.gradient, self.cost = self.trial, found.matrix, found.gradient, found.cost
            self.trial = self.trial.clone()
            return
        self.values = torch.where(better[:, None], self.trial, self.values)
        self.gradient = torch.where(better[:, None], found.gradient, self.gradient)
        self.cost = torch.where(better, found.cost, self.cost)
        self.matrix = torch.where(better[:, None, None], found.matrix, self.matrix)

    def select(self, chosen: Tensor) -> "_Work":
        """The given problems."""
        return _Work(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})

    @classmethod
    def joined(cls, parts: list["_Work"]) -> "_Work":
        """All problems again, in their first order."""
        order = torch.cat([part.rows for part in parts]).argsort()
        columns = {field.name: [getattr(part, field.name) for part in parts] for field in fields(cls)}
        return cls(**{name: torch.cat(column)[order] for name, column in columns.items()})


def _is_finite(found: NormalEquations) -> Tensor:
    # A sum is finite only if all its terms are: one pass, no mask of the size of the matrix.
    return (found.cost + found.gradient.sum(-1) + found.matrix.sum((-2, -1))).isfinite()
