"""Smoothing: frames of a recording estimated again by what comes after them.

A recording of one camera, or of several under an update rule without a hull, is followed a second time from its end to
its beginning (`BackwardPass`); the two paths are compared (`path_weights`) and combined (`combined_hand`). In a hull,
where a frame takes much longer, the last frames alone are estimated again where a hand was found anew (`Smoother`).
"""

from torchhand.track.smoothing.backward import BackwardPass, SecondEstimate
from torchhand.track.smoothing.combination import PosedHand, combined_hand
from torchhand.track.smoothing.paths import HandPath, path_weights
from torchhand.track.smoothing.window import PastFrame, Smoother

__all__ = [
    "BackwardPass",
    "HandPath",
    "PastFrame",
    "PosedHand",
    "SecondEstimate",
    "Smoother",
    "combined_hand",
    "path_weights",
]
