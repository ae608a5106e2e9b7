"""Plain gradient descent for many independent problems at once, within bounds: the first-order counterpart of
`levenberg_marquardt`."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import asks_after, read_back
from torchhand.numerics.least_squares.box_step import flat_bounds
from torchhand.numerics.least_squares.levenberg_marquardt import Linearise
from torchhand.numerics.least_squares.records import LeastSquares, NormalEquations, Status, normal_equations
from torchhand.numerics.least_squares.robust import RobustLoss
from torchhand.precision import full_precision

_MIN_DIAGONAL = 1e-12  # of the largest entry of the diagonal: variables without any influence get a finite scale


@dataclass(frozen=True, kw_only=True)
class DescentSettings:
    """Step lengths, and when to stop."""

    iterations: int = 100
    """Most evaluations after that at the start; 1 or more."""
    rate: float = 0.2
    """First step, in units of scale² × gradient; above 0."""
    growth: float = 1.5
    """Factor by which a step that lowers the cost multiplies the rate; 1 or more."""
    shrink: float = 0.4
    """Factor by which a step that does not lower the cost multiplies the rate; between 0 and 1."""
    cost_tolerance: float = 1e-9
    """Converged when a step taken lowers the cost by at most this share of it; 0 or more."""
    min_rate: float = 1e-10
    """Rate at which a problem has stalled whose cost no step has lowered; above 0."""

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"iterations: expected 1 or more, got {self.iterations!r}")
        if not 0 < self.min_rate < self.rate < float("inf"):
            raise ValueError(f"rate: expected above min_rate, both above 0, got {self.rate!r}, {self.min_rate!r}")
        if not 1 <= self.growth < float("inf"):
            raise ValueError(f"growth: expected 1 or more and finite, got {self.growth!r}")
        if not 0 < self.shrink < 1:
            raise ValueError(f"shrink: expected between 0 and 1, got {self.shrink!r}")
        if not 0 <= self.cost_tolerance < float("inf"):
            raise ValueError(f"cost_tolerance: expected 0 or more and finite, got {self.cost_tolerance!r}")


@torch.no_grad()
@full_precision
def gradient_descent(
    linearise: Linearise,
    start: Float[Tensor, "*batch n"],
    *,
    lower: Float[Tensor, "*#batch n"] | None = None,
    upper: Float[Tensor, "*#batch n"] | None = None,
    scale: Float[Tensor, "*#batch n"] | None = None,
    robust: RobustLoss | None = None,
    settings: DescentSettings | None = None,
    takes_rows: bool = False,
) -> LeastSquares:
    """Minimise what `levenberg_marquardt` does, with the gradient alone; same arguments, same result.

    A step is -rate · scale² · gradient, put into the bounds, and taken only if it lowers the cost; the rate of every
    problem grows with steps taken and shrinks with steps refused. scale: typical changes of the variables, which may
    have different units; that of the curvature at the start, (JᵀJ)ᵢᵢ^(-1/2), where it is None.
    """
    settings = settings or DescentSettings()
    batch, size = start.shape[:-1], start.shape[-1]
    low, high = flat_bounds(lower, upper, start)

    def evaluate(values: Tensor) -> NormalEquations:
        if takes_rows:
            return normal_equations(linearise(values, rows), robust)
        return _flat(normal_equations(linearise(values.reshape(start.shape)), robust))

    def bounded(values: Tensor) -> Tensor:
        return values if low is None else values.clamp(low, high)

    values = bounded(start.reshape(-1, size).clone())
    rows = torch.arange(len(values), device=values.device)
    here = evaluate(values)
    is_open = here.cost.isfinite() & here.gradient.isfinite().all(-1)
    status = torch.where(is_open, Status.STALLED.value, Status.FAILED.value)
    squared = _squared_scale(here, scale, start)
    rate = torch.full_like(here.cost, settings.rate)
    iterations = torch.zeros_like(rows)
    for turn in range(settings.iterations):
        trial = bounded(values - rate[:, None] * squared * here.gradient)
        is_still = is_open & (trial == values).all(-1)
        status = status.masked_fill(is_still, Status.CONVERGED.value)
        is_open = is_open & ~is_still & (rate > settings.min_rate)
        if asks_after(turn, values.device) and not read_back(is_open).any():
            break
        trial = torch.where(is_open[:, None], trial, values)
        found = evaluate(trial)
        iterations += is_open
        better = is_open & found.cost.isfinite() & found.gradient.isfinite().all(-1) & (found.cost < here.cost)
        done = better & (here.cost - found.cost <= settings.cost_tolerance * here.cost)
        status = status.masked_fill(done, Status.CONVERGED.value)
        rate = torch.where(better, rate * settings.growth, rate * settings.shrink)
        values, here = torch.where(better[:, None], trial, values), _where(better, found, here)
        is_open = is_open & ~done
    on_bound = torch.zeros_like(values, dtype=torch.bool)
    if low is not None and high is not None:
        on_bound = (values <= low) | (values >= high)
    return LeastSquares(
        values=values.reshape(start.shape),
        cost=here.cost.reshape(batch),
        status=status.reshape(batch),
        iterations=iterations.reshape(batch),
        matrix=here.matrix.reshape(*batch, size, size),
        gradient=here.gradient.reshape(start.shape),
        on_bound=on_bound.reshape(start.shape),
    )


def _flat(equations: NormalEquations) -> NormalEquations:
    """The same with one batch dimension."""
    size = equations.gradient.shape[-1]
    return NormalEquations(
        matrix=equations.matrix.reshape(-1, size, size),
        gradient=equations.gradient.reshape(-1, size),
        cost=equations.cost.reshape(-1),
    )


def _squared_scale(here: NormalEquations, scale: Tensor | None, start: Tensor) -> Tensor:
    """Squares of the typical changes, of flat problems; those of the curvature where they are not given."""
    if scale is not None:
        return scale.to(start).expand(start.shape).reshape(here.gradient.shape).square()
    diagonal = here.matrix.diagonal(dim1=-2, dim2=-1)
    floor = _MIN_DIAGONAL * diagonal.amax(-1, keepdim=True) + torch.finfo(diagonal.dtype).tiny
    return torch.maximum(diagonal, floor).reciprocal()


def _where(choose: Tensor, one: NormalEquations, other: NormalEquations) -> NormalEquations:
    """The equations of `one` for the problems that `choose` names, those of `other` elsewhere."""
    return NormalEquations(
        matrix=torch.where(choose[:, None, None], one.matrix, other.matrix),
        gradient=torch.where(choose[:, None], one.gradient, other.gradient),
        cost=torch.where(choose, one.cost, other.cost),
    )
