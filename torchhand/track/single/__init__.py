"""Single pictures: the hand in any posture, every picture by itself."""

from torchhand.track.single.fitter import PoseSource, SinglePose, SinglePoseFitter
from torchhand.track.single.settings import SinglePoseSettings

__all__ = ["PoseSource", "SinglePose", "SinglePoseFitter", "SinglePoseSettings"]
