"""Experiments over many hypotheses."""

from torchhand.study.perturbation import PerturbationSettings, draw_perturbations, seed_of, spread_of_starts

__all__ = [
    "PerturbationSettings",
    "draw_perturbations",
    "seed_of",
    "spread_of_starts",
]
