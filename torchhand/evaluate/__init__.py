"""How results are judged: errors of position, angle, motion and silhouette, continuity, and honesty of covariances."""

from torchhand.evaluate.alignment import Similarity, fit_similarity
from torchhand.evaluate.angles import flexion_deg, without_offset
from torchhand.evaluate.continuity import Continuity, continuity
from torchhand.evaluate.evaluation import evaluate
from torchhand.evaluate.nees import Consistency, area_under_curve, consistency, normalised_errors_squared
from torchhand.evaluate.planar_motion import PlanarMotionErrors, planar_motion_errors
from torchhand.evaluate.pose_errors import PoseErrors, pose_errors
from torchhand.evaluate.positions import (
    MIDDLE_MCP,
    WRIST,
    aligned_errors,
    fingertip_distances,
    fingertip_errors,
    joint_errors,
    root_relative_errors,
)
from torchhand.evaluate.timing import (
    PROC,
    THREAD_VARIABLES,
    Timing,
    machine_facts,
    memory_growth,
    resident_memory,
    time_interleaved,
    watch_memory,
)
from torchhand.evaluate.tracked_silhouettes import MaskOfFrame, tracked_projector, tracked_silhouettes
from torchhand.evaluate.truth import Truth, load_mask, load_truth, numbered_pictures
from torchhand.evaluate.without_truth import (
    JointRange,
    JointStability,
    RecordingFacts,
    Stability,
    differences,
    range_of_motion,
    stability,
)

__all__ = [
    "MIDDLE_MCP",
    "PROC",
    "THREAD_VARIABLES",
    "WRIST",
    "Consistency",
    "Continuity",
    "JointRange",
    "JointStability",
    "MaskOfFrame",
    "PlanarMotionErrors",
    "PoseErrors",
    "RecordingFacts",
    "Similarity",
    "Stability",
    "Timing",
    "Truth",
    "aligned_errors",
    "area_under_curve",
    "consistency",
    "continuity",
    "differences",
    "evaluate",
    "fingertip_distances",
    "fingertip_errors",
    "fit_similarity",
    "flexion_deg",
    "joint_errors",
    "load_mask",
    "load_truth",
    "machine_facts",
    "memory_growth",
    "normalised_errors_squared",
    "numbered_pictures",
    "planar_motion_errors",
    "pose_errors",
    "range_of_motion",
    "resident_memory",
    "root_relative_errors",
    "stability",
    "time_interleaved",
    "tracked_projector",
    "tracked_silhouettes",
    "watch_memory",
    "without_offset",
]
