"""One time: what the cameras give, how a hand agrees with it, and which of several hands explains it best."""

from torchhand.track.scene.agreement import Agreement, SilhouetteComparison, mean_overlap
from torchhand.track.scene.candidate import Candidate
from torchhand.track.scene.health import Health, HealthSettings
from torchhand.track.scene.keypoints import SceneKeypoints, detected_hand, parts_of, scene_keypoints
from torchhand.track.scene.likelihood import (
    EVIDENCE,
    TABLE,
    EvidenceDensity,
    HandTest,
    LikelihoodRatio,
    evidence,
    measured_test,
)
from torchhand.track.scene.segmentation import (
    ColourSegmentation,
    ColourUpdateSettings,
    Looks,
    RigSegmentation,
    Segmentation,
)
from torchhand.track.scene.silhouettes import Images, LearnedSkin, Masks, PackedMask, ViewSilhouettes
from torchhand.track.scene.update_rule import UpdateRule
from torchhand.track.scene.views import DetectedHand, Scene, View

__all__ = [
    "EVIDENCE",
    "TABLE",
    "Agreement",
    "Candidate",
    "ColourSegmentation",
    "ColourUpdateSettings",
    "DetectedHand",
    "EvidenceDensity",
    "HandTest",
    "Health",
    "HealthSettings",
    "Images",
    "LearnedSkin",
    "LikelihoodRatio",
    "Looks",
    "Masks",
    "PackedMask",
    "RigSegmentation",
    "Scene",
    "SceneKeypoints",
    "Segmentation",
    "SilhouetteComparison",
    "UpdateRule",
    "View",
    "ViewSilhouettes",
    "detected_hand",
    "evidence",
    "mean_overlap",
    "measured_test",
    "parts_of",
    "scene_keypoints",
]
