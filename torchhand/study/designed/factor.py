"""What a factor of a study is: a value by which a trial differs from the plain one."""

from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

from torchhand.errors import require
from torchhand.study.designed.trial import Trial


@runtime_checkable
class Factor(Protocol):
    """A way in which trials differ. To vary something new, write one such class and give it to `Study(kinds=...)`."""

    def value(self, given: Any) -> Any:
        """The value as trials take it. Raises ValueError naming what was expected."""
        ...

    def apply(self, trial: Trial, value: Any) -> Trial:
        """The trial with that value."""
        ...


@dataclass(frozen=True)
class Number:
    """A number of the trial, within bounds."""

    name: str
    low: float | int
    high: float | int
    is_whole: bool = False

    def value(self, given: Any) -> float | int:
        kind, number = "a whole number" if self.is_whole else "a number", given
        is_number = isinstance(number, (int, float)) and not isinstance(number, bool)
        require(
            is_number and self.low <= number <= self.high, self.name, f"{kind}, {self.low:g} to {self.high:g}", given
        )
        require(not self.is_whole or number == round(number), self.name, kind, given)
        return round(number) if self.is_whole else float(number)

    def apply(self, trial: Trial, value: Any) -> Trial:
        return replace(trial, **{self.name: value})


@dataclass(frozen=True)
class Choice:
    """One of some words."""

    name: str
    allowed: tuple[str, ...]

    def value(self, given: Any) -> str:
        require(given in self.allowed, self.name, f"one of {', '.join(self.allowed)}", given)
        return given

    def apply(self, trial: Trial, value: Any) -> Trial:
        return replace(trial, **{self.name: value})
