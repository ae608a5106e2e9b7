"""Hands fitted to keypoints, in space or in pictures; keypoints as observations."""

from torchhand.fit.keypoints.fit import KeypointFit, fit_keypoints
from torchhand.fit.keypoints.observation import PictureKeypoints, SpaceKeypoints
from torchhand.fit.keypoints.points import Detector, KeypointSettings
from torchhand.fit.keypoints.settings import KeypointFitSettings
from torchhand.fit.keypoints.world import WorldKeypoints

__all__ = [
    "Detector",
    "KeypointFit",
    "KeypointFitSettings",
    "KeypointSettings",
    "PictureKeypoints",
    "SpaceKeypoints",
    "WorldKeypoints",
    "fit_keypoints",
]
