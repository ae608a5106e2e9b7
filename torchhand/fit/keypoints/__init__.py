"""Hands fitted to keypoints, in space or in pictures."""

from torchhand.fit.keypoints.fit import KeypointFit, fit_keypoints
from torchhand.fit.keypoints.observation import KeypointSettings, PictureKeypoints, SpaceKeypoints
from torchhand.fit.keypoints.settings import KeypointFitSettings

__all__ = [
    "KeypointFit",
    "KeypointFitSettings",
    "KeypointSettings",
    "PictureKeypoints",
    "SpaceKeypoints",
    "fit_keypoints",
]
