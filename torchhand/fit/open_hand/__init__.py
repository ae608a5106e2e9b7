"""Proportions from one picture of an open hand."""

from torchhand.fit.open_hand.fit import Facing, OpenHand, facing_of, fit_open_hand
from torchhand.fit.open_hand.hand_size import HandSize, known_length, length_at_distance, population_length, sized

__all__ = [
    "Facing",
    "HandSize",
    "OpenHand",
    "facing_of",
    "fit_open_hand",
    "known_length",
    "length_at_distance",
    "population_length",
    "sized",
]
