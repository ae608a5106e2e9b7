"""Single pictures: the hand in any posture, every picture by itself."""

from torchhand.track.single.evidence import EVIDENCE, HandOdds, counted, evidence_for, hand_odds
from torchhand.track.single.fitter import HandHypothesis, PoseSource, SinglePose, SinglePoseFitter
from torchhand.track.single.settings import SinglePoseSettings
from torchhand.track.single.sources import learned_poses

__all__ = [
    "EVIDENCE",
    "HandHypothesis",
    "HandOdds",
    "PoseSource",
    "SinglePose",
    "SinglePoseFitter",
    "SinglePoseSettings",
    "counted",
    "evidence_for",
    "hand_odds",
    "learned_poses",
]
