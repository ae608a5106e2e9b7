"""How much more likely the evidence for a hand is where it is right than where it is another hand, or none."""

import itertools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from torchhand.errors import require
from torchhand.track.scene.candidate import Candidate

TABLE = Path(__file__).with_name("status_rates.json")
"""What `torchhand measure_status` writes."""
EVIDENCE = ("overlap", "edges", "beyond")
"""What the ratio is made of; what is unexplained tells little that the overlap does not."""

_GOOD = (1.0, 1.0, -1.0)  # which way each evidence speaks for a hand
_LEAST_SHARE = 0.02  # shares are told apart from 0 and 1 so far
_SPECK = 0.005  # squares of the hand's length: areas below it are all the same


def evidence(candidate: Candidate) -> tuple[float, ...]:
    """What speaks for a candidate, in the order of EVIDENCE: shares as log-odds, areas as logarithms."""
    shares = (_log_odds(share) for share in (candidate.agreement.overlap, candidate.edges))
    return (*shares, math.log(candidate.agreement.mean_beyond + _SPECK))


@dataclass(frozen=True, kw_only=True)
class EvidenceDensity:
    """Independent Gaussians, one for each evidence."""

    mean: tuple[float, ...]
    std: tuple[float, ...]

    def nats(self, values: tuple[float, ...]) -> float:
        """Logarithm of the density."""
        return -sum(
            0.5 * ((value - mean) / std) ** 2 + math.log(std * math.sqrt(2 * math.pi))
            for value, mean, std in zip(values, self.mean, self.std, strict=True)
        )


@dataclass(frozen=True, kw_only=True)
class LikelihoodRatio:
    """Of right hands to wrong ones and none, which are as likely as each other."""

    right: EvidenceDensity
    wrong: EvidenceDensity
    none: EvidenceDensity

    def nats(self, values: tuple[float, ...]) -> float:
        """Logarithm of the ratio for evidence.

        Evidence that is better than that of the mean right hand counts as this: it is no sign of another thing.
        """
        known = zip(values, self.right.mean, _GOOD, strict=True)
        values = tuple(mean + sign * min(0.0, sign * (value - mean)) for value, mean, sign in known)
        wrong, none = self.wrong.nats(values), self.none.nats(values)
        most = max(wrong, none)
        others = most + math.log(0.5 * math.exp(wrong - most) + 0.5 * math.exp(none - most))
        return self.right.nats(values) - others


@dataclass(frozen=True, kw_only=True)
class HandTest:
    """A likelihood ratio, and from where on a proposed hand is one."""

    ratio: LikelihoodRatio
    thresholds: Mapping[float, float]
    """By false-alarm rate, the share of wrong and absent hands that pass: nats."""

    def passes(self, candidate: Candidate, false_alarm_rate: float) -> bool:
        """Whether it is a hand, at a rate inside the table."""
        return self.ratio.nats(evidence(candidate)) >= self.threshold(false_alarm_rate)

    def threshold(self, false_alarm_rate: float) -> float:
        """Nats; between the rates of the table on a logarithmic scale. Raises ValueError outside these."""
        rates = sorted(self.thresholds)
        expected = f"{rates[0]:g} to {rates[-1]:g}"
        require(rates[0] <= false_alarm_rate <= rates[-1], "health.false_alarm_rate", expected, false_alarm_rate)
        low, high = next(pair for pair in itertools.pairwise(rates) if false_alarm_rate <= pair[1])
        share = math.log(false_alarm_rate / low) / math.log(high / low)
        return (1 - share) * self.thresholds[low] + share * self.thresholds[high]


@cache
def measured_test(config: str) -> HandTest:
    """The test that was measured for a configuration of one camera. Raises KeyError for one that was not measured."""
    table = json.loads(TABLE.read_text(encoding="utf-8"))[config]
    kinds = {
        kind: EvidenceDensity(
            mean=tuple(table["densities"][name][kind][0] for name in EVIDENCE),
            std=tuple(table["densities"][name][kind][1] for name in EVIDENCE),
        )
        for kind in ("right", "wrong", "none")
    }
    thresholds = {float(rate): float(entry["nats"]) for rate, entry in table["found"].items()}
    return HandTest(ratio=LikelihoodRatio(**kinds), thresholds=thresholds)


def _log_odds(share: float) -> float:
    inside = min(max(share, _LEAST_SHARE), 1 - _LEAST_SHARE)
    return math.log(inside / (1 - inside))
