"""What all frames of a problem share and is estimated with their poses: the shape, and numbers of an observation."""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import HOST, constant_tensor, kept, sent_to
from torchhand.hand import Anthropometry
from torchhand.numerics.least_squares import NormalEquations


@runtime_checkable
class SharedPrior(Protocol):
    """A belief about the shape in nats."""

    def equations(self, shape: Float[Tensor, "shape"]) -> NormalEquations:
        """Normal equations in all shape parameters, in their own units; no batch dimension."""
        ...


@dataclass(frozen=True, kw_only=True)
class PopulationPrior:
    """What is known of people's hands: the normal distribution over people, and the anthropometric constraints beyond
    the bounds as soft walls (Ouhaddi and Horain 1998, section 3.1)."""

    population: Anthropometry
    weight: float = 1.0
    mean: Float[Tensor, "shape"] | None = None
    """Mean over people; the default of the shape space where None."""

    def equations(self, shape: Float[Tensor, "shape"]) -> NormalEquations:
        """Normal equations in all shape parameters."""
        residual, rows = population_rows(self.population, shape, self.mean)
        weighted = self.weight * rows
        return NormalEquations(
            matrix=weighted.T @ rows, gradient=weighted.T @ residual, cost=0.5 * self.weight * residual.square().sum()
        )


@dataclass(frozen=True, kw_only=True)
class ShapePrior:
    """A shape that is expected, its parameters' errors independent; one of spread 0 is not free."""

    mean: Float[Tensor, "shape"]
    std: Float[Tensor, "shape"]

    def equations(self, shape: Float[Tensor, "shape"]) -> NormalEquations:
        """Normal equations in all shape parameters."""
        precision = torch.where(self.std > 0, self.std.square().reciprocal(), 0.0)
        away = shape - self.mean
        return NormalEquations(
            matrix=precision.diag(), gradient=precision * away, cost=0.5 * (precision * away.square()).sum()
        )


def population_rows(
    population: Anthropometry, shape: Float[Tensor, "shape"], mean: Float[Tensor, "shape"] | None = None
) -> tuple[Float[Tensor, "rows"], Float[Tensor, "rows shape"]]:
    """Residuals in standard deviations and their derivative in the parameters: the normal distribution over people,
    with length and breadth correlated, and those constraints beyond the bounds that are broken. mean: over people; the
    default of the shape space where None."""
    known = _constants_of(population, shape.dtype, shape.device)
    scaled = (shape - (known.mean if mean is None else mean)) / known.std
    excess = (known.matrix @ shape - known.bound) / known.scale
    of_excess = (excess > 0)[:, None] * known.matrix / known.scale[:, None]
    return torch.cat((known.rows @ scaled, excess.clamp_min(0))), torch.cat((known.rows / known.std, of_excess))


@dataclass(frozen=True, kw_only=True)
class _Population:
    """What is known of people's hands, as matrices."""

    mean: Float[Tensor, "shape"]
    std: Float[Tensor, "shape"]
    rows: Float[Tensor, "shape shape"]
    """Of the parameters in standard deviations: such as do not depend on each other."""
    matrix: Float[Tensor, "constraints shape"]
    bound: Float[Tensor, "constraints"]
    scale: Float[Tensor, "constraints"]
    """Standard deviation of every constraint."""


@kept(8)
def _constants_of(population: Anthropometry, dtype: torch.dtype, device: torch.device) -> _Population:
    """Sent to a device once."""
    space, count = population.space, len(population.space.names)
    length, breadth = (space.names.index(name) for name in ("hand_length", "hand_breadth"))
    rho = population.settings.length_breadth_correlation
    rows = torch.eye(count, dtype=dtype)
    rows[breadth] /= math.sqrt(1 - rho * rho)
    rows[breadth, length] = -rho / math.sqrt(1 - rho * rho)
    spread = population.spread.to(dtype, copy=True)
    spread[-1] *= float(space.default[length])
    found = _Population(
        mean=space.default.to(dtype),
        std=space.std.to(dtype),
        rows=rows,
        matrix=population.matrix[2 * count :].to(dtype),
        bound=population.bound[2 * count :].to(dtype),
        scale=population.settings.softness * torch.cat((spread, spread)),
    )
    return sent_to(found, device)


@dataclass(frozen=True, kw_only=True)
class SharedUnknowns:
    """The unknowns that all frames have in common."""

    columns: tuple[int, ...]
    """Shape parameters that are free, by their place in the shape space."""
    prior: SharedPrior
    lower: Float[Tensor, "shape"]
    """Bounds of all shape parameters."""
    upper: Float[Tensor, "shape"]
    extra: Float[Tensor, "extra"]
    """Start of further numbers that belong to an observation, such as a scale; often none. They have no bounds."""
    extra_std: Float[Tensor, "extra"]
    """Standard deviation of each about what is expected of it."""
    extra_mean: Float[Tensor, "extra"] | None = None
    """Expected values of the extra unknowns; their start where None."""
    population: Anthropometry | None = None
    """Constraints that the estimated shape keeps exactly in the end; on the way there it may violate what the prior
    does not forbid."""
    pliable: tuple[int, ...] = ()
    """Shape parameters of which the observations tell nothing, and which give way to the constraints."""

    @classmethod
    def of_shape(
        cls, population: Anthropometry, columns: tuple[int, ...] | None = None, *, weight: float = 1.0
    ) -> "SharedUnknowns":
        """The shape alone, within the bounds of its space; all of its parameters where no columns are given."""
        space = population.space
        nothing = space.default.new_zeros(0)
        return cls(
            columns=tuple(range(len(space.names))) if columns is None else columns,
            prior=PopulationPrior(population=population, weight=weight),
            lower=space.lower,
            upper=space.upper,
            extra=nothing,
            extra_std=nothing,
        )

    @property
    def size(self) -> int:
        return len(self.columns) + len(self.extra)

    def vector(self, shape: Float[Tensor, "shape"]) -> Float[Tensor, "c"]:
        """The unknowns at their start."""
        return torch.cat((shape[self.places(shape.device)], self.extra.to(shape)))

    def shape(self, vector: Float[Tensor, "c"], start: Float[Tensor, "shape"]) -> Float[Tensor, "shape"]:
        """The whole shape: free parameters of the vector, others of the start."""
        return start.index_copy(0, self.places(vector.device), vector[: len(self.columns)])

    def feasible(self, vector: Float[Tensor, "c"], start: Float[Tensor, "shape"]) -> Float[Tensor, "shape"]:
        """The whole shape, put into the constraints; parameters that are neither free nor pliable stay."""
        shape = self.shape(vector, start)
        if self.population is None or not self.columns:
            return shape
        moving = torch.tensor(sorted({*self.columns, *self.pliable}), device=shape.device)
        return shape.index_copy(0, moving, self.population.project(shape.to(HOST)).to(shape)[moving])

    def extras(self, vector: Float[Tensor, "c"]) -> Float[Tensor, "extra"]:
        """The numbers after the shape."""
        return vector[len(self.columns) :]

    def bounds(self, like: Tensor) -> tuple[Float[Tensor, "c"], Float[Tensor, "c"]]:
        """Bounds of the vector."""
        open_end = like.new_full((len(self.extra),), torch.inf)
        chosen = self.places(like.device)
        return torch.cat((self.lower.to(like)[chosen], -open_end)), torch.cat((self.upper.to(like)[chosen], open_end))

    def prior_equations(self, vector: Float[Tensor, "c"], start: Float[Tensor, "shape"]) -> NormalEquations:
        """What is believed of the unknowns, in the vector."""
        found, chosen = self.prior.equations(self.shape(vector, start)), self.places(vector.device)
        mean = self.extra if self.extra_mean is None else self.extra_mean
        away = (self.extras(vector) - mean.to(vector)) / self.extra_std.to(vector)
        size, count = self.size, len(self.columns)
        matrix = vector.new_zeros(size, size)
        matrix[:count, :count] = found.matrix[chosen][:, chosen]
        matrix[count:, count:] = torch.diag(self.extra_std.to(vector) ** -2)
        gradient = torch.cat((found.gradient[chosen], away / self.extra_std.to(vector)))
        return NormalEquations(matrix=matrix, gradient=gradient, cost=found.cost + 0.5 * away.square().sum())

    def places(self, device: torch.device) -> Int[Tensor, "columns"]:
        """Free parameters' places in the shape."""
        return constant_tensor(self.columns, torch.long, device)
