"""The factors of designed studies, by name."""

from typing import get_args

from torchhand.simulate import SKIN_TONES
from torchhand.study.designed.factors.factor import Choice, Factor, Number
from torchhand.study.designed.factors.perturbed import Perturbed
from torchhand.study.designed.trial import ObservationKind

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

FACTORS: dict[str, Factor] = {one.name: one for one in (*_NUMBERS, *_CHOICES)} | {"perturbation": Perturbed()}
"""Those that `Study` knows without being told."""

__all__ = ["FACTORS", "Choice", "Factor", "Number", "Perturbed"]
