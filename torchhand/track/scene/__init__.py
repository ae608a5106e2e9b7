"""One time: what the cameras give, how a hand agrees with it, and which of several hands explains it best."""

from torchhand.track.scene.agreement import (
    Agreement,
    AlikeViews,
    PlacedHand,
    SeenHand,
    SilhouetteComparison,
    mean_overlap,
)
from torchhand.track.scene.arm_end import END_REACH, hand_end, lengths_to_end
from torchhand.track.scene.candidate import Candidate
from torchhand.track.scene.health import MAX_BEYOND, MIN_KEYPOINTS, ONE_PLACE_M, Health, HealthSettings
from torchhand.track.scene.keypoints import (
    SceneKeypoints,
    detected_hand,
    deviations_of_digits,
    parts_of,
    scene_keypoints,
    with_further_postures,
)
from torchhand.track.scene.learned_posture import (
    credible_posture,
    learned_observations,
    seen_posture,
    seen_presence,
    seen_silhouette,
)
from torchhand.track.scene.segmentation import (
    Appearances,
    ColourSegmentation,
    RigSegmentation,
    Segmentation,
    points_of,
)
from torchhand.track.scene.silhouettes import Images, LearnedSkin, Masks, PackedMask, ViewSilhouettes
from torchhand.track.scene.update_rule import UpdateRule
from torchhand.track.scene.views import Box, HandKeypoints, ObservationsOf, Scene, View
from torchhand.track.scene.working_views import WorkingViews, is_same_view

__all__ = [
    "END_REACH",
    "MAX_BEYOND",
    "MIN_KEYPOINTS",
    "ONE_PLACE_M",
    "Agreement",
    "AlikeViews",
    "Appearances",
    "Box",
    "Candidate",
    "ColourSegmentation",
    "HandKeypoints",
    "Health",
    "HealthSettings",
    "Images",
    "LearnedSkin",
    "Masks",
    "ObservationsOf",
    "PackedMask",
    "PlacedHand",
    "RigSegmentation",
    "Scene",
    "SceneKeypoints",
    "SeenHand",
    "Segmentation",
    "SilhouetteComparison",
    "UpdateRule",
    "View",
    "ViewSilhouettes",
    "WorkingViews",
    "credible_posture",
    "detected_hand",
    "deviations_of_digits",
    "hand_end",
    "is_same_view",
    "learned_observations",
    "lengths_to_end",
    "mean_overlap",
    "parts_of",
    "points_of",
    "scene_keypoints",
    "seen_posture",
    "seen_presence",
    "seen_silhouette",
    "with_further_postures",
]
