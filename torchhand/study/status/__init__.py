"""How well the trackers tell a hand from another one and from none, on simulated pictures."""

from torchhand.study.status.collect import KINDS, Sample, collect
from torchhand.study.status.empty import EmptyPicture, Finder, first_frame, reported_hands
from torchhand.study.status.rates import derived_table

__all__ = [
    "KINDS",
    "EmptyPicture",
    "Finder",
    "Sample",
    "collect",
    "derived_table",
    "first_frame",
    "reported_hands",
]
