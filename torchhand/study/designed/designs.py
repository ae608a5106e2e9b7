"""Designs: which values of the factors are tried together."""

import importlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from torchhand.errors import InputError, require

Values = Mapping[str, Any]
"""A value for every factor."""


@dataclass(frozen=True)
class Between:
    """All numbers from low to high, where a design draws them."""

    low: float | int
    high: float | int

    def at(self, fraction: float) -> float:
        return self.low + fraction * (self.high - self.low)


Range = Between | Sequence[Any]
"""What a factor's values are from: all numbers between two, or some levels."""


@runtime_checkable
class Design(Protocol):
    """A choice of cells."""

    def cells(self, factors: Mapping[str, Range], crossed: str | None, seed: int) -> list[Values]:
        """Values of every cell; crossed: a factor all of whose levels go with everything else. Raises ValueError."""
        ...


def _levels(name: str, values: Range) -> Sequence[Any]:
    require(not isinstance(values, Between), name, "levels: only a Latin hypercube draws from between two", values)
    assert not isinstance(values, Between)
    return values


@dataclass(frozen=True)
class Full:
    """Every level of every factor with every level of the others."""

    def cells(self, factors: Mapping[str, Range], crossed: str | None, seed: int) -> list[Values]:
        levels = [_levels(name, values) for name, values in factors.items()]
        return [dict(zip(factors, chosen, strict=True)) for chosen in itertools.product(*levels)]


@dataclass(frozen=True)
class OneAtATime:
    """Every factor by itself, the others at their first levels; the crossed one with all of them."""

    def cells(self, factors: Mapping[str, Range], crossed: str | None, seed: int) -> list[Values]:
        levels = {name: _levels(name, values) for name, values in factors.items()}
        plain = {name: own[0] for name, own in levels.items()}
        varied = [name for name in levels if name != crossed]
        found = [plain] + [plain | {name: value} for name in varied for value in levels[name][1:]]
        if crossed is None:
            return list(found)
        return [cell | {crossed: value} for value in levels[crossed] for cell in found]


@dataclass(frozen=True)
class LatinHypercube:
    """So many cells that cover the range of every factor evenly (scipy.stats.qmc); the crossed one with all of them."""

    count: int

    def __post_init__(self) -> None:
        require(1 <= self.count <= 100_000, "design.latin_hypercube", "1 to 100000", self.count)

    def cells(self, factors: Mapping[str, Range], crossed: str | None, seed: int) -> list[Values]:
        try:
            qmc: Any = importlib.import_module("scipy.stats.qmc")
        except ImportError as error:
            raise InputError("a Latin hypercube needs SciPy: pip install 'torchhand[study]'") from error
        drawn = [name for name in factors if name != crossed]
        require(bool(drawn), "factors", "one besides the crossed one for a Latin hypercube", list(factors))
        points = qmc.LatinHypercube(len(drawn), rng=seed % 2**63).random(self.count).tolist()
        cells = [
            {name: _at(factors[name], fraction) for name, fraction in zip(drawn, point, strict=True)}
            for point in points
        ]
        if crossed is None:
            return list(cells)
        return [cell | {crossed: value} for value in _levels(crossed, factors[crossed]) for cell in cells]


def _at(values: Range, fraction: float) -> Any:
    return values.at(fraction) if isinstance(values, Between) else values[int(fraction * len(values))]


def design_of(given: Any) -> Design:
    """A design as `Study` and YAML name it. Raises ValueError."""
    named: dict[str, Design] = {"full": Full(), "one_at_a_time": OneAtATime()}
    if isinstance(given, dict) and set(given) == {"latin_hypercube"} and isinstance(given["latin_hypercube"], int):
        return LatinHypercube(given["latin_hypercube"])
    if isinstance(given, str):
        require(given in named, "design", "full, one_at_a_time or {latin_hypercube: N}", given)
        return named[given]
    if isinstance(given, Design):
        return given
    raise ValueError(f"design: expected full, one_at_a_time or {{latin_hypercube: N}}, got {given!r}")
