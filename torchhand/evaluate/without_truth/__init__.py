"""What results tell without a truth: one by itself, or two of the same recording beside each other."""

from torchhand.evaluate.without_truth.range_of_motion import JointRange, range_of_motion
from torchhand.evaluate.without_truth.same_recording import RecordingFacts, differences
from torchhand.evaluate.without_truth.stability import JointStability, Stability, stability

__all__ = [
    "JointRange",
    "JointStability",
    "RecordingFacts",
    "Stability",
    "differences",
    "range_of_motion",
    "stability",
]
