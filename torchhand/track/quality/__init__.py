"""How far an estimate can be trusted, finger by finger."""

from torchhand.track.quality.evidence import EVIDENCE, FingerEvidence, Told

__all__ = ["EVIDENCE", "FingerEvidence", "Told"]
