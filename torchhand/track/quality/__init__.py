"""How far an estimate can be trusted, finger by finger."""

from torchhand.track.quality.evidence import EVIDENCE, FingerEvidence, Told
from torchhand.track.quality.probability import (
    HAND_EVIDENCE,
    TIP_M,
    LogisticModel,
    Method,
    hand_evidence,
    qualities,
)

__all__ = [
    "EVIDENCE",
    "HAND_EVIDENCE",
    "TIP_M",
    "FingerEvidence",
    "LogisticModel",
    "Method",
    "Told",
    "hand_evidence",
    "qualities",
]
