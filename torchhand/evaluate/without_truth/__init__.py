"""What results tell without a truth: one by itself, or two of the same recording beside each other."""

from torchhand.evaluate.without_truth.range_of_motion import JointRange, range_of_motion
from torchhand.evaluate.without_truth.stability import JointStability, Stability, stability

__all__ = ["JointRange", "JointStability", "Stability", "range_of_motion", "stability"]
