"""How much more likely the evidence for a hand is where it is right than where it is another hand, or none."""

import math
from dataclasses import dataclass

from torchhand.track.scene import Candidate

EVIDENCE = ("overlap", "edges", "beyond")
"""What the ratio is made of; what is unexplained tells little that the overlap does not."""

_GOOD = (1.0, 1.0, -1.0)  # which way each evidence speaks for a hand
_MIN_FRACTION = 0.02  # shares are told apart from 0 and 1 so far
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
        greater = max(wrong, none)
        others = greater + math.log(0.5 * math.exp(wrong - greater) + 0.5 * math.exp(none - greater))
        return self.right.nats(values) - others


def _log_odds(share: float) -> float:
    inside = min(max(share, _MIN_FRACTION), 1 - _MIN_FRACTION)
    return math.log(inside / (1 - inside))
