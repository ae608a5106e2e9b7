"""The factors of designed studies, by name."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

from torchhand.errors import require
from torchhand.simulate import SKIN_TONES
from torchhand.study.designed.factor import Choice, Factor, Number
from torchhand.study.designed.perturbations import Perturbation, perturbation_of
from torchhand.study.designed.trial import ObservationKind, Trial


@dataclass(frozen=True)
class Perturbed:
    """A distribution of starts, or what YAML says of one."""

    def value(self, given: Any) -> Perturbation:
        found = perturbation_of(given)
        require(hasattr(found, "draw") and hasattr(found, "std"), "perturbation", "a perturbation", given)
        return found

    def apply(self, trial: Trial, value: Any) -> Trial:
        return replace(trial, perturbation=value)


_NUMBERS = (
    Number("perturbation_size", 0, 20),
    Number("frame_rate", 0.1, 10_000),
    Number("hypotheses", 1, 1024, is_whole=True),
    Number("cameras", 1, 8, is_whole=True),
    Number("missing_views", 0, 1),
    Number("noise", 0, 100),
    Number("blur_px", 0, 50),
    Number("mask_noise_px", 0, 50),
    Number("occlusion", 0, 1),
    Number("ambient", 0, 1),
    Number("dropout", 0, 1),
    Number("point_std_mm", 0.01, 1000),
    Number("shape_spread", 0, 5),
    Number("focal_error", -0.9, 10),
    Number("centre_error_px", -1000, 1000),
    Number("camera_turn_deg", 0, 90),
)
_CHOICES = (Choice("observation", get_args(ObservationKind)), Choice("skin", tuple(SKIN_TONES)))

FACTORS: Mapping[str, Factor] = {
    **{one.name: one for one in (*_NUMBERS, *_CHOICES)},
    "perturbation": Perturbed(),
}
"""Those that `Study` knows without being told."""
