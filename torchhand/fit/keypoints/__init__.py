"""Hands fitted to keypoints, in space or in pictures; keypoints as observations."""

from torchhand.fit.keypoints.fit import KeypointFit, fit_keypoints, refine_cameras
from torchhand.fit.keypoints.observation import PictureKeypoints
from torchhand.fit.keypoints.placement import place_hand
from torchhand.fit.keypoints.points import Detector, KeypointSettings, keep_frames
from torchhand.fit.keypoints.posture import PostureKeypoints
from torchhand.fit.keypoints.prior import NaturalPrior, limit_information, natural_posture
from torchhand.fit.keypoints.relative import RelativeKeypoints
from torchhand.fit.keypoints.rig import RefinedCameras, triangulated
from torchhand.fit.keypoints.seen import SeenKeypoints
from torchhand.fit.keypoints.settings import KeypointFitSettings
from torchhand.fit.keypoints.views import starts_in_picture
from torchhand.fit.keypoints.world import WorldKeypoints

__all__ = [
    "Detector",
    "KeypointFit",
    "KeypointFitSettings",
    "KeypointSettings",
    "NaturalPrior",
    "PictureKeypoints",
    "PostureKeypoints",
    "RefinedCameras",
    "RelativeKeypoints",
    "SeenKeypoints",
    "WorldKeypoints",
    "fit_keypoints",
    "keep_frames",
    "limit_information",
    "natural_posture",
    "place_hand",
    "refine_cameras",
    "starts_in_picture",
    "triangulated",
]
