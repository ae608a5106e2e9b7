"""From evidence to a likelihood ratio and its thresholds at false-alarm rates; how often fixed thresholds are wrong."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.study.status.collect import KINDS, Sample
from torchhand.study.status.likelihood import EVIDENCE, EvidenceDensity, LikelihoodRatio, evidence
from torchhand.track.scene import Health

RATES = (0.01, 0.02, 0.05, 0.1)
"""False-alarm rates for which thresholds are written."""
_MIN_STD = 0.1  # log-odds or logarithms
_MIN_SAMPLES = 10  # samples of a kind


def derived_table(samples: Sequence[Sample], health: Health) -> dict[str, Any]:
    """Densities of the evidence, thresholds of the likelihood ratio and their misses, and the rates of `health`.

    found: the false-alarm rate is the share of wrong and absent hands that are found. failing: that of right hands that
    are failing. beyond: squares of the hand's length that so large a share of right hands exceeds. health: shares of
    each kind that the fixed thresholds call found and failing. Raises ValueError where there are too few of a kind.
    """
    rows = {kind: torch.tensor([evidence(s.candidate) for s in samples if s.kind == kind]).double() for kind in KINDS}
    for kind, values in rows.items():
        if len(values) < _MIN_SAMPLES:
            raise ValueError(f"samples: expected {_MIN_SAMPLES} or more of the kind {kind!r}, got {len(values)}")
    densities = {kind: _density(values) for kind, values in rows.items()}
    ratio = LikelihoodRatio(**densities)
    nats = {
        kind: torch.tensor([ratio.nats(tuple(row)) for row in values.tolist()], dtype=torch.float64)
        for kind, values in rows.items()
    }
    other = torch.cat((nats["wrong"], nats["none"]))
    found = {rate: float(torch.quantile(other, 1 - rate)) for rate in RATES}
    failing = {rate: float(torch.quantile(nats["right"], rate)) for rate in RATES}
    beyond = torch.tensor([s.candidate.agreement.mean_beyond for s in samples if s.kind == "right"]).double()
    fixed = {}
    for kind in KINDS:
        own = [s.candidate for s in samples if s.kind == kind]
        fixed[kind] = {
            "found": _fraction([health.is_found(one) for one in own]),
            "failing": _fraction([health.is_failing(one) for one in own]),
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
            str(rate): {"nats": _rounded(t), "missed_right": _fraction((nats["right"] < t).tolist())}
            for rate, t in found.items()
        },
        "failing": {
            str(rate): {
                "nats": _rounded(t),
                "missed_wrong": _fraction((nats["wrong"] >= t).tolist()),
                "missed_none": _fraction((nats["none"] >= t).tolist()),
            }
            for rate, t in failing.items()
        },
    }


def _density(rows: Float[Tensor, "samples evidence"]) -> EvidenceDensity:
    return EvidenceDensity(mean=tuple(rows.mean(0).tolist()), std=tuple(rows.std(0).clamp_min(_MIN_STD).tolist()))


def _fraction(hits: Sequence[bool]) -> float:
    return _rounded(sum(hits) / max(1, len(hits)))


def _rounded(value: float | Tensor) -> float:
    return round(float(value), 3)
