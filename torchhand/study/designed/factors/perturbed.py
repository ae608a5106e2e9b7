"""How far starts are off, as a factor."""

from dataclasses import dataclass, replace
from typing import Any

from torchhand.errors import require
from torchhand.study.designed.perturbations import Perturbation, perturbation_of
from torchhand.study.designed.trial import Trial


@dataclass(frozen=True)
class Perturbed:
    """A distribution of starts, or what YAML says of one."""

    def value(self, given: Any) -> Perturbation:
        found = perturbation_of(given)
        require(hasattr(found, "draw") and hasattr(found, "std"), "perturbation", "a perturbation", given)
        return found

    def apply(self, trial: Trial, value: Any) -> Trial:
        return replace(trial, perturbation=value)
