"""Finds a hand in a single picture without a first guess, and fits pose and proportions to its edges."""

from torchhand.fit.detect.alignment import Alignment, align_posture
from torchhand.fit.detect.edge_fit import Fit, FitSettings
from torchhand.fit.detect.facing import facing_rotation, turned_in_picture
from torchhand.fit.detect.keypoint_cut import CutAtKeypoints, are_colours_shared, cut_at_keypoints
from torchhand.fit.detect.start import (
    ContourFitter,
    NoStart,
    Start,
    StartPoints,
    coloured_at,
    find_hand,
    fit_overlap,
    segment_hand,
    start_at_cut,
    start_at_points,
    start_at_pose,
)

__all__ = [
    "Alignment",
    "ContourFitter",
    "CutAtKeypoints",
    "Fit",
    "FitSettings",
    "NoStart",
    "Start",
    "StartPoints",
    "align_posture",
    "are_colours_shared",
    "coloured_at",
    "cut_at_keypoints",
    "facing_rotation",
    "find_hand",
    "fit_overlap",
    "segment_hand",
    "start_at_cut",
    "start_at_points",
    "start_at_pose",
    "turned_in_picture",
]
