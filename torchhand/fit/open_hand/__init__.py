"""Proportions from one picture of an open hand."""

from torchhand.fit.open_hand.fit import Facing, OpenHand, facing_of, fit_open_hand
from torchhand.fit.open_hand.hand_size import HandSize, known_length, length_at_distance, population_length, sized
from torchhand.fit.open_hand.photograph import HandInPicture, hand_in_picture

__all__ = [
    "Facing",
    "HandInPicture",
    "HandSize",
    "OpenHand",
    "facing_of",
    "fit_open_hand",
    "hand_in_picture",
    "known_length",
    "length_at_distance",
    "population_length",
    "sized",
]
