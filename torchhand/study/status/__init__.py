"""How well the trackers tell a hand from another one and from none, on simulated pictures."""

from torchhand.study.status.collect import KINDS, Kind, Sample, collect
from torchhand.study.status.rates import EVIDENCE, EvidenceDensity, derived_table, log_likelihood_ratio

__all__ = [
    "EVIDENCE",
    "KINDS",
    "EvidenceDensity",
    "Kind",
    "Sample",
    "collect",
    "derived_table",
    "log_likelihood_ratio",
]
