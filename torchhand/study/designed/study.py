"""A study as its designer writes it, in Python or YAML: factors, a design, how many trials on how many pictures."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from torchhand.errors import InputError, require, require_positive
from torchhand.files import load_settings
from torchhand.files.disk import read_plain_file, read_yaml, suggestion
from torchhand.study.designed.designs import Between, Design, Range, Values, design_of
from torchhand.study.designed.factor import Factor
from torchhand.study.designed.factors import FACTORS
from torchhand.study.designed.trial import Trial
from torchhand.study.hypotheses import STUDY_SPACES

_LARGEST_BYTES = 1 << 20
_PLAIN = ("trials", "pictures", "seed", "success_deg", "space", "crossed", "has_start_prior")


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One combination of the factors' values."""

    index: int
    values: Values
    trial: Trial


@dataclass(frozen=True, kw_only=True)
class Study:
    """Registration under varied conditions: simulated hands, whose truth is known, cell by cell of a design.

    Study(factors={"observation": ["outline", "points"], "blur_px": Between(0, 6)}, design=LatinHypercube(64)) has 64
    cells. What no factor varies is as in `Trial`, or as `fixed` says.
    """

    factors: Mapping[str, Range]
    """Values by the factor's name: a list of levels, or `Between(low, high)` for a Latin hypercube."""
    design: Design | str | Mapping[str, int] = "full"
    """Full, one at a time, or a Latin hypercube, as `design_of` takes their names; or a design of one's own."""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    """Values of factors that all cells have in common."""
    crossed: str | None = None
    """Factor whose levels each go with the whole design of the others; lines of the plots. None: none."""
    trials: int = 40
    """Trials of every cell, shared out over its pictures; 1 to 100000."""
    pictures: int = 20
    """Simulated hands, the same ones for all cells; 1 to as many as there are trials."""
    seed: int = 0
    """Seed of everything random; every cell on every picture has one of its own that follows from it."""
    success_deg: float = 5.0
    """Largest mean error of the joint angles of a success; above 0."""
    space: str = "dof26"
    """Pose space."""
    has_start_prior: bool = True
    """The registration knows how far starts may be off."""
    kinds: Mapping[str, Factor] = field(default_factory=lambda: FACTORS)
    """Factors that there are, by name."""

    def __post_init__(self) -> None:
        require(bool(self.factors), "factors", "one or more", dict(self.factors))
        object.__setattr__(self, "design", design_of(self.design))
        for name, values in (*self.factors.items(), *((name, [value]) for name, value in self.fixed.items())):
            if name not in self.kinds:
                hint = suggestion(name, self.kinds)
                raise ValueError(f"factors: {name}: unknown{hint}; allowed: {', '.join(self.kinds)}")
            is_range = isinstance(values, Between) or (isinstance(values, (list, tuple)) and bool(values))
            require(is_range, name, "a list of levels or the two ends {low, high}", values)
        twice = set(self.factors) & set(self.fixed)
        require(not twice, "fixed", "no factor that is varied", ", ".join(sorted(twice)))
        for name, low, high in (("trials", 1, 100_000), ("pictures", 1, self.trials)):
            require(low <= getattr(self, name) <= high, name, f"{low} to {high}", getattr(self, name))
        require(-(2**63) <= self.seed < 2**63, "seed", "a number of 64 bits", self.seed)
        require_positive("success_deg", self.success_deg)
        require(self.space in STUDY_SPACES, "space", f"one of {', '.join(STUDY_SPACES)}", self.space)
        is_crossed = self.crossed is None or self.crossed in self.factors
        require(is_crossed, "crossed", f"one of {', '.join(self.factors)}", self.crossed)
        object.__setattr__(self, "_cells", tuple(self._made_cells()))

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All cells, in their order."""
        return self.__dict__["_cells"]

    def described(self) -> dict[str, Any]:
        """The study as JSON takes it: equal studies, and only they, are described alike."""
        plain = {name: getattr(self, name) for name in _PLAIN}
        cells = [{name: text_of(value) for name, value in cell.values.items()} for cell in self.cells]
        return plain | {"fixed": {name: text_of(value) for name, value in self.fixed.items()}, "cells": cells}

    def _made_cells(self) -> Iterator[Cell]:
        design = design_of(self.design)
        given = {name: self._values(name, values) for name, values in self.factors.items()}
        fixed = {name: self.kinds[name].value(value) for name, value in self.fixed.items()}
        for index, drawn in enumerate(design.cells(given, self.crossed, self.seed)):
            values = {name: self._drawn(name, drawn[name]) for name in self.factors}
            trial = Trial()
            for name, value in (*fixed.items(), *values.items()):
                trial = self.kinds[name].apply(trial, value)
            yield Cell(index=index, values=values, trial=trial)

    def _values(self, name: str, values: Range) -> Range:
        """Checked: each level, or both ends."""
        if isinstance(values, Between):
            require(values.low < values.high, name, "a low end below the high one", (values.low, values.high))
            return Between(float(self._drawn(name, values.low)), float(self._drawn(name, values.high)))
        return [self.kinds[name].value(value) for value in values]

    def _drawn(self, name: str, value: Any) -> Any:
        """As the factor takes it; what was drawn of whole numbers is rounded."""
        is_whole = getattr(self.kinds[name], "is_whole", False) and isinstance(value, float)
        return self.kinds[name].value(round(value) if is_whole else value)


def text_of(value: Any) -> str | float | int:
    """A factor's value for tables: numbers and words as they are, what else there is as its text."""
    return value if isinstance(value, (int, float, str)) else str(value)


def load_study(path: Path) -> Study:
    """A study of a YAML file: the fields of `Study`, ranges as {low: 0, high: 4}. Raises InputError naming the key."""
    try:
        text = read_plain_file(path, largest=_LARGEST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected a YAML text file in UTF-8, got something else") from error
    content = read_yaml(text, str(path))
    if not isinstance(content, dict) or not isinstance(content.get("factors"), dict):
        raise InputError(f"{path}: expected the keys of a study with factors, got {type(content).__name__}")
    known = [one.name for one in fields(Study) if one.name != "kinds"]
    unknown = next((key for key in content if key not in known), None)
    if unknown is not None:
        raise InputError(
            f"{path}: {unknown}: unknown key{suggestion(str(unknown), known)}; allowed: {', '.join(known)}"
        )
    if not isinstance(content.get("fixed", {}), dict):
        raise InputError(f"{path}: fixed: expected values by the names of factors, got {content['fixed']!r}")
    plain = {name: content[name] for name in _PLAIN if name in content}
    load_settings(_PlainFields(), None, plain)  # checks the types
    factors = {str(name): _range(values) for name, values in content["factors"].items()}
    further = {name: content[name] for name in ("design", "fixed") if name in content}
    try:
        return Study(factors=factors, **plain, **further)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


@dataclass(frozen=True, kw_only=True)
class _PlainFields:
    """The fields of `Study` that YAML has as they are."""

    trials: int = 1
    pictures: int = 1
    seed: int = 0
    success_deg: float = 1.0
    space: str = ""
    crossed: str | None = None
    has_start_prior: bool = True


def _range(values: Any) -> Any:
    is_between = isinstance(values, dict) and set(values) == {"low", "high"}
    if is_between and all(isinstance(end, (int, float)) for end in values.values()):
        return Between(values["low"], values["high"])
    return values
