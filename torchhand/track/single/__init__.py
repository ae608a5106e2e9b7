"""Single pictures: the hand in any posture, every picture by itself."""

from torchhand.track.single.fitter import PoseSource, SinglePose, SinglePoseFitter
from torchhand.track.single.settings import SinglePoseSettings
from torchhand.track.single.silhouette_table import SilhouetteTable

__all__ = ["PoseSource", "SilhouetteTable", "SinglePose", "SinglePoseFitter", "SinglePoseSettings"]
