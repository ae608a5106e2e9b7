"""Single pictures: the hand in any posture, every picture by itself."""

from torchhand.track.single.evidence import EVIDENCE, HandOdds, counted
from torchhand.track.single.fitter import HandHypothesis, PoseSource, SinglePose, SinglePoseFitter
from torchhand.track.single.settings import SinglePoseSettings

__all__ = [
    "EVIDENCE",
    "HandHypothesis",
    "HandOdds",
    "PoseSource",
    "SinglePose",
    "SinglePoseFitter",
    "SinglePoseSettings",
    "counted",
]
