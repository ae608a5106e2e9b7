"""How results are judged: errors of position, angle, motion and silhouette, continuity, and honesty of covariances."""

from torchhand.study.alignment import Similarity, fit_similarity
from torchhand.study.angles import flexion_deg, without_offset
from torchhand.study.continuity import Continuity, continuity
from torchhand.study.evaluation import evaluate
from torchhand.study.nees import Consistency, consistency, normalised_errors_squared
from torchhand.study.planar_motion import PlanarMotionErrors, planar_motion_errors
from torchhand.study.positions import aligned_errors, joint_errors, root_relative_errors
from torchhand.study.tracked_silhouettes import MaskOfFrame, tracked_projector, tracked_silhouettes
from torchhand.study.truth import Truth, load_mask, load_truth, numbered_pictures

__all__ = [
    "Consistency",
    "Continuity",
    "MaskOfFrame",
    "PlanarMotionErrors",
    "Similarity",
    "Truth",
    "aligned_errors",
    "consistency",
    "continuity",
    "evaluate",
    "fit_similarity",
    "flexion_deg",
    "joint_errors",
    "load_mask",
    "load_truth",
    "normalised_errors_squared",
    "numbered_pictures",
    "planar_motion_errors",
    "root_relative_errors",
    "tracked_projector",
    "tracked_silhouettes",
    "without_offset",
]
