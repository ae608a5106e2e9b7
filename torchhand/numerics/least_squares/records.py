"""Records of nonlinear least squares: settings, the quadratic model of a cost, the result problem by problem."""

from dataclasses import dataclass, fields
from enum import IntEnum

from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.numerics.least_squares.robust import RobustLoss


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
    """Damping at the start, relative to the diagonal of JᵀJ; above 0."""
    max_damping: float = 1e8
    """Damping at which a problem has stalled whose cost no step has lowered; above `damping`."""
    cost_tolerance: float = 1e-12
    """Converged when the predicted decrease is at most this share of the cost; 0 or more."""
    step_tolerance: float = 1e-9
    """Converged when a step is at most this share of the length of the values; 0 or more."""
    cost_floor: float = 0.0
    """Converged when the cost is at most this; 0 or more."""

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"iterations: expected 1 or more, got {self.iterations!r}")
        if not 0 < self.damping < self.max_damping < float("inf"):
            raise ValueError(
                "damping: expected above 0 and below max_damping, both finite,"
                f" got {self.damping!r} and {self.max_damping!r}"
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
    """Cost ½ rᵀr."""


@dataclass(frozen=True, kw_only=True)
class LeastSquares:
    """What came out, problem by problem."""

    values: Float[Tensor, "*batch n"]
    """The best found, within the bounds."""
    cost: Float[Tensor, "*batch"]
    """Half the sum of squares (or the robust loss) at the values."""
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
"""Residuals (*batch, m) and their Jacobian (*batch, m, n), or what follows from them."""


def normal_equations(found: Linearisation, robust: RobustLoss | None) -> NormalEquations:
    """Normal equations; of a robust loss those of iteratively reweighted least squares: the gradient is exact."""
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
