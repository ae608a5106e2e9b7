"""What a hand can do: joint limits, couplings between joints, and the proportions of people."""

from torchhand.hand.limits.anatomy import anatomical_skeleton
from torchhand.hand.limits.anthropometry import MEASURES, Anthropometry, AnthropometrySettings
from torchhand.hand.limits.constraints import ConstraintSettings, PoseConstraints
from torchhand.hand.limits.couplings import ABDUCTIONS, FLEXIONS, NEIGHBOUR_BANDS_DEG, TIES
from torchhand.hand.limits.joint_limits import clamp_to_limits
from torchhand.hand.limits.violation import Violation

__all__ = [
    "ABDUCTIONS",
    "FLEXIONS",
    "MEASURES",
    "NEIGHBOUR_BANDS_DEG",
    "TIES",
    "Anthropometry",
    "AnthropometrySettings",
    "ConstraintSettings",
    "PoseConstraints",
    "Violation",
    "anatomical_skeleton",
    "clamp_to_limits",
]
