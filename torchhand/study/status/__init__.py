"""How well the trackers tell a hand from another one and from none, on simulated pictures."""

from torchhand.study.status.collect import KINDS, Sample, collect
from torchhand.study.status.empty import EmptyPicture, Finder, drawn_pictures, first_frame, reported_hands
from torchhand.study.status.rates import derived_table
from torchhand.study.status.single import WeighedPicture, evidence_table, weighed_pictures

__all__ = [
    "KINDS",
    "EmptyPicture",
    "Finder",
    "Sample",
    "WeighedPicture",
    "collect",
    "derived_table",
    "drawn_pictures",
    "evidence_table",
    "first_frame",
    "reported_hands",
    "weighed_pictures",
]
