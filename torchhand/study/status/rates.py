"""From evidence to a likelihood ratio and its thresholds at false-alarm rates; how often fixed thresholds are wrong."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.study.status.collect import KINDS, Kind, Sample
from torchhand.track.scene import Candidate, Health

RATES = (0.01, 0.02, 0.05, 0.1)
"""False-alarm rates for which thresholds are written."""
EVIDENCE = ("overlap", "edges", "beyond")
"""What the ratio is made of; what is unexplained tells little that the overlap does not."""

_GOOD = torch.tensor((1.0, 1.0, -1.0), dtype=torch.float64)  # which way each evidence speaks for a hand
_LEAST_SHARE = 0.02  # shares are told apart from 0 and 1 so far
_SPECK = 0.005  # squares of the hand's length: areas below it are all the same
_FEWEST = 10  # samples of a kind


def evidence(candidate: Candidate) -> tuple[float, ...]:
    """What speaks for a candidate, in the order of EVIDENCE: shares as log-odds, areas as logarithms."""
    shares = (_log_odds(share) for share in (candidate.agreement.overlap, candidate.edges))
    return (*shares, math.log(candidate.agreement.mean_beyond + _SPECK))


@dataclass(frozen=True, kw_only=True)
class EvidenceDensity:
    """Independent Gaussians of one kind of candidates."""

    mean: Float[Tensor, "evidence"]
    std: Float[Tensor, "evidence"]

    @classmethod
    def of(cls, rows: Float[Tensor, "samples evidence"]) -> "EvidenceDensity":
        return cls(mean=rows.mean(0), std=rows.std(0).clamp_min(0.1))

    def nats(self, rows: Float[Tensor, "samples evidence"]) -> Float[Tensor, "samples"]:
        """Logarithm of the density."""
        return -(0.5 * ((rows - self.mean) / self.std) ** 2 + (self.std * math.sqrt(2 * math.pi)).log()).sum(-1)


def log_likelihood_ratio(
    rows: Float[Tensor, "samples evidence"], densities: dict[Kind, EvidenceDensity]
) -> Float[Tensor, "samples"]:
    """Of the right hand to a wrong one or none, which are as likely as each other, nats.

    Evidence that is better than that of the mean right hand counts as this: it is no sign of another thing.
    """
    mean = densities["right"].mean
    rows = mean + _GOOD * torch.minimum(_GOOD * (rows - mean), torch.zeros(()).double())
    others = torch.stack([densities[kind].nats(rows) for kind in ("wrong", "none")])
    return densities["right"].nats(rows) - others.logsumexp(0) + math.log(2)


def derived_table(samples: Sequence[Sample], health: Health) -> dict[str, Any]:
    """Densities of the evidence, thresholds of the likelihood ratio and their misses, and the rates of `health`.

    found: the false-alarm rate is the share of wrong and absent hands that are found. failing: that of right hands that
    are failing. beyond: squares of the hand's length that so large a share of right hands exceeds. health: shares of
    each kind that the fixed thresholds call found and failing. Raises ValueError where there are too few of a kind.
    """
    rows = {kind: torch.tensor([evidence(s.candidate) for s in samples if s.kind == kind]).double() for kind in KINDS}
    for kind, values in rows.items():
        if len(values) < _FEWEST:
            raise ValueError(f"samples: expected {_FEWEST} or more of the kind {kind!r}, got {len(values)}")
    densities = {kind: EvidenceDensity.of(values) for kind, values in rows.items()}
    nats = {kind: log_likelihood_ratio(values, densities) for kind, values in rows.items()}
    other = torch.cat((nats["wrong"], nats["none"]))
    found = {rate: float(torch.quantile(other, 1 - rate)) for rate in RATES}
    failing = {rate: float(torch.quantile(nats["right"], rate)) for rate in RATES}
    beyond = rows["right"][:, EVIDENCE.index("beyond")].exp() - _SPECK
    fixed = {}
    for kind in KINDS:
        own = [s.candidate for s in samples if s.kind == kind]
        fixed[kind] = {
            "found": _share([health.is_found(one) for one in own]),
            "failing": _share([health.is_failing(one) for one in own]),
        }
    return {
        "samples": {kind: len(values) for kind, values in rows.items()},
        "health": fixed,
        "beyond": {str(rate): round(float(torch.quantile(beyond, 1 - rate)), 3) for rate in RATES},
        "densities": {
            name: {kind: [_rounded(one.mean[i]), _rounded(one.std[i])] for kind, one in densities.items()}
            for i, name in enumerate(EVIDENCE)
        },
        "found": {
            str(rate): {"nats": _rounded(t), "missed_right": _share((nats["right"] < t).tolist())}
            for rate, t in found.items()
        },
        "failing": {
            str(rate): {
                "nats": _rounded(t),
                "missed_wrong": _share((nats["wrong"] >= t).tolist()),
                "missed_none": _share((nats["none"] >= t).tolist()),
            }
            for rate, t in failing.items()
        },
    }


def _log_odds(share: float) -> float:
    inside = min(max(share, _LEAST_SHARE), 1 - _LEAST_SHARE)
    return math.log(inside / (1 - inside))


def _share(hits: Sequence[bool]) -> float:
    return _rounded(sum(hits) / max(1, len(hits)))


def _rounded(value: float | Tensor) -> float:
    return round(float(value), 3)
