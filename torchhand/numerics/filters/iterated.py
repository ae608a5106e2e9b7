"""The iterated extended Kalman filter: the measurement update as Gauss-Newton on the posterior's mode.

Where the measurement curves within the prior's spread, one linearisation at the prediction is off; here it is repeated
at every new estimate, which ends at the maximum a posteriori state (Bell and Cathey 1993). Steps that raise the cost
are halved, and the best iterate is kept.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import asks_after, read_back
from torchhand.numerics.filters.cholesky import robust_cholesky
from torchhand.numerics.filters.extended import Linearised, masked_and_gated
from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.square_root import PosteriorRoot
from torchhand.numerics.filters.unscented import Update
from torchhand.numerics.filters.whitening import is_full, masked_noise, noise_root, whiten, wrapped
from torchhand.precision import full_precision


@dataclass(frozen=True, kw_only=True)
class IteratedSettings:
    """How often the measurement is linearised anew."""

    iterations: int = 10
    """Most linearisations; 1 or more. With 1 the mean is that of the extended filter."""
    tolerance: float = 1e-4
    """A step shorter than this many posterior standard deviations ends the iteration; above 0."""
    halvings: int = 8
    """How often a step that raises the cost is halved before the iteration stops; 0 or more."""

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"iterated.iterations: expected 1 or more, got {self.iterations!r}")
        if not self.tolerance > 0:
            raise ValueError(f"iterated.tolerance: expected above 0, got {self.tolerance!r}")
        if self.halvings < 0:
            raise ValueError(f"iterated.halvings: expected 0 or more, got {self.halvings!r}")


DEFAULT_SETTINGS = IteratedSettings()


@dataclass(frozen=True, kw_only=True)
class IteratedUpdate:
    """An update and how its iteration ended."""

    update: Update
    """Innovation, its variance and the gate are those at the prediction; the covariance is that at the last estimate.
    `nis` is twice the cost at the estimate, which on a linear problem is νᵀ S⁻¹ ν."""
    iterations: Int[Tensor, "*batch"]
    """Number of steps taken."""
    is_converged: Bool[Tensor, "*batch"]
    """False where steps ran out or no shorter step lowered the cost; the best estimate is returned all the same."""


@dataclass(frozen=True, kw_only=True)
class _Point:
    """One estimate of every filter: offsets y from the prior in units of its square root, and what is seen there."""

    offset: Tensor  # (*batch, k)
    residual: Tensor  # (*batch, m) whitened
    rows: Tensor  # (*batch, m, k) whitened, per unit of y

    @property
    def cost(self) -> Tensor:
        return 0.5 * (self.offset.square().sum(-1) + self.residual.square().sum(-1))

    @property
    def is_finite(self) -> Tensor:
        return self.residual.isfinite().all(-1) & self.rows.isfinite().all((-2, -1))

    def where(self, choose: Tensor, other: "_Point") -> "_Point":
        """This point where `choose`, the other one elsewhere."""
        return _Point(
            offset=torch.where(choose[..., None], self.offset, other.offset),
            residual=torch.where(choose[..., None], self.residual, other.residual),
            rows=torch.where(choose[..., None, None], self.rows, other.rows),
        )


@full_precision
def update_iterated(
    state: Gaussian,
    observe: Linearised,
    measurement: Measurement,
    settings: IteratedSettings = DEFAULT_SETTINGS,
    *,
    gate: float | None = None,
    group: int = 1,
    period: Float[Tensor, "m"] | None = None,
    observed: int | None = None,
) -> IteratedUpdate:
    """Measurement update at the mode of ½ |x - x₀|²_P + ½ |z - h(x)|²_R, P and R as weights.

    observe    takes states (*batch, k), k = n or `observed`, and returns values (*batch, m) and Jacobian (*batch, m, k)
    period     of each measurement, infinite for those that do not repeat: differences are wrapped by it
    observed   `observe` depends on the first k components only, is given only those and returns k columns
    gate, group   as in `update_extended`; what is used is decided once, at the prediction: the gate, and that a
               measurement, its value and its row of the Jacobian there are finite

    Estimates at which `observe` returns NaN or an infinity for a used measurement are never accepted.
    """
    seen = _observed(state, observed)
    if period is not None and not bool((period > 0).all()):
        raise ValueError("period must be above 0, infinite where a measurement does not repeat")
    root = robust_cholesky(state.covariance)
    inner = root[..., :seen, :seen]

    values, jacobian = observe(state.mean[..., :seen])
    innovation, rows, variance, used = masked_and_gated(
        root,
        _difference(measurement.value, values, period),
        jacobian,
        measurement.noise,
        valid=measurement.valid,
        gate=gate,
        group=group,
    )
    full = is_full(measurement.noise, measurement.value)
    whitener = noise_root(masked_noise(measurement.noise, used, measurement.value), full=full)

    def point(offset: Tensor, innovation: Tensor, rows: Tensor) -> _Point:
        both = torch.cat((innovation.unsqueeze(-1), rows), -1)
        both = whiten(whitener, torch.where(used.unsqueeze(-1), both, 0.0), full=full)
        return _Point(offset=offset, residual=both[..., 0], rows=both[..., 1:])

    def evaluated(offset: Tensor) -> _Point:
        values, jacobian = observe(state.mean[..., :seen] + (inner @ offset.unsqueeze(-1)).squeeze(-1))
        # Masked before the product, so that a NaN spoils no gradient either.
        jacobian = torch.where(used.unsqueeze(-1), jacobian, 0.0)
        return point(offset, _difference(measurement.value, values, period), jacobian @ inner)

    mode = _mode(point(torch.zeros_like(state.mean[..., :seen]), innovation, rows), evaluated, settings)
    count = used.sum(-1)
    has_any = (count > 0).unsqueeze(-1)
    outer, hidden = root[..., :seen], root[..., seen:]
    mean = state.mean + (outer @ mode.best.offset.unsqueeze(-1)).squeeze(-1)
    covariance = mode.left.covariance(outer) + hidden @ hidden.mT
    covariance = 0.5 * (covariance + covariance.mT)
    posterior = Gaussian(
        torch.where(has_any, mean, state.mean), torch.where(has_any.unsqueeze(-1), covariance, state.covariance)
    )
    update = Update(
        state=posterior,
        innovation=innovation,
        innovation_variance=variance,
        used=used,
        nis=2 * mode.best.cost,
        count=count,
    )
    return IteratedUpdate(update=update, iterations=mode.steps, is_converged=mode.is_converged)


@dataclass(frozen=True, kw_only=True)
class _Mode:
    """Where the iteration ended."""

    best: _Point
    left: PosteriorRoot  # at that point
    steps: Tensor  # (*batch,) taken
    is_converged: Tensor  # (*batch,)


def _mode(start: _Point, evaluated: Callable[[Tensor], _Point], settings: IteratedSettings) -> _Mode:
    """Gauss-Newton from a point until steps are short; `evaluated` gives the point of an offset."""
    best, left = start, PosteriorRoot.of(start.rows)
    steps = torch.zeros_like(best.cost, dtype=torch.int64)
    is_converged = torch.zeros_like(best.cost, dtype=torch.bool)
    is_stuck = torch.zeros_like(is_converged)
    for turn in range(settings.iterations):
        step, length = left.step(best.residual, best.offset)
        is_converged = is_converged | (~is_stuck & (length <= settings.tolerance))
        moving = ~is_converged & ~is_stuck
        if asks_after(turn, best.cost.device) and not read_back(moving).any():
            break
        best, is_better = _line_search(best, step, moving, evaluated, settings.halvings)
        steps = steps + is_better
        is_stuck = is_stuck | (moving & ~is_better)
        left = PosteriorRoot.of(best.rows)
    length = left.step(best.residual, best.offset)[1]
    is_converged = is_converged | (~is_stuck & (length <= settings.tolerance))
    return _Mode(best=best, left=left, steps=steps, is_converged=is_converged)


def _line_search(
    start: _Point, step: Tensor, moving: Tensor, evaluated: Callable[[Tensor], _Point], halvings: int
) -> tuple[_Point, Tensor]:
    """The first point along the step, halved again and again, whose cost is not above that of the start; where there
    is none the start itself. Also tells which filters have moved."""
    best, is_better = start, torch.zeros_like(moving)
    allowed = start.cost * (1 + 16 * torch.finfo(start.cost.dtype).eps)
    scale = torch.ones_like(start.cost)
    for halving in range(halvings + 1):
        trial = evaluated(start.offset + (scale * moving).unsqueeze(-1) * step)
        improves = moving & ~is_better & trial.is_finite & (trial.cost <= allowed)
        best = trial.where(improves, best)
        is_better = is_better | improves
        if asks_after(halving, start.cost.device) and read_back(is_better | ~moving).all():
            break
        scale = torch.where(is_better, scale, 0.5 * scale)
    return best, is_better


def _observed(state: Gaussian, observed: int | None) -> int:
    size = state.mean.shape[-1]
    seen = size if observed is None else observed
    if not 1 <= seen <= size:
        raise ValueError(f"observed must be None or 1 to {size}, got {observed!r}")
    return seen


def _difference(measured: Tensor, values: Tensor, period: Tensor | None) -> Tensor:
    """Measured minus observed values, wrapped where they repeat."""
    if values.shape != measured.shape:
        raise ValueError(f"observe must return values {tuple(measured.shape)}, got {tuple(values.shape)}")
    return measured - values if period is None else wrapped(measured - values, period)
