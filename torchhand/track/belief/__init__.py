"""What is believed of a followed hand: state, dynamics within the joint limits, weak priors of posture, its report."""

from torchhand.track.belief.estimate import (
    PosedBelief,
    posed_belief,
    posed_gaussian,
    unknown_scale_std,
)
from torchhand.track.belief.motion import HandMotion
from torchhand.track.belief.posture import PostureMeasurements, posture_prior
from torchhand.track.belief.settings import NoiseSettings, PosturePriorSettings
from torchhand.track.belief.state import FollowedHand

__all__ = [
    "FollowedHand",
    "HandMotion",
    "NoiseSettings",
    "PosedBelief",
    "PostureMeasurements",
    "PosturePriorSettings",
    "posed_belief",
    "posed_gaussian",
    "posture_prior",
    "unknown_scale_std",
]
