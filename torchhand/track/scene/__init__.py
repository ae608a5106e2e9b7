"""One time: what the cameras give, how a hand agrees with it, and which of several hands explains it best."""

from torchhand.track.scene.agreement import Agreement, SilhouetteComparison, mean_overlap
from torchhand.track.scene.candidate import Candidate
from torchhand.track.scene.health import Health, HealthSettings
from torchhand.track.scene.keypoints import keypoint_observations
from torchhand.track.scene.segmentation import (
    ColourSegmentation,
    ColourUpdateSettings,
    Looks,
    RigSegmentation,
    Segmentation,
)
from torchhand.track.scene.silhouettes import Images, LearnedSkin, Masks, PackedMask, ViewSilhouettes
from torchhand.track.scene.update_rule import UpdateRule
from torchhand.track.scene.views import DetectedHand, ObservationsOf, Scene, View

__all__ = [
    "Agreement",
    "Candidate",
    "ColourSegmentation",
    "ColourUpdateSettings",
    "DetectedHand",
    "Health",
    "HealthSettings",
    "Images",
    "LearnedSkin",
    "Looks",
    "Masks",
    "ObservationsOf",
    "PackedMask",
    "RigSegmentation",
    "Scene",
    "Segmentation",
    "SilhouetteComparison",
    "UpdateRule",
    "View",
    "ViewSilhouettes",
    "keypoint_observations",
    "mean_overlap",
]
