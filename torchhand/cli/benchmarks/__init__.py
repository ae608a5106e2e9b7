"""What `torchhand benchmark` measures."""

from torchhand.cli.benchmarks.figures import Figure, Peer, line_of
from torchhand.cli.benchmarks.fit_hand import fit_hand_bones
from torchhand.cli.benchmarks.hand import kinematics_compiled, kinematics_forward, kinematics_forward_backward, skinning
from torchhand.cli.benchmarks.iteration import lm_iteration_jacfwd, lm_iteration_pypose
from torchhand.cli.benchmarks.model import keypoints_to_pose, mesh_silhouettes, mesh_volume, pose_projection
from torchhand.cli.benchmarks.multiview import track_views, track_views_memory
from torchhand.cli.benchmarks.pictures import crops, soft_silhouettes
from torchhand.cli.benchmarks.registration import many_hypotheses, one_registration
from torchhand.cli.benchmarks.runs import own_environment
from torchhand.cli.benchmarks.soak import soak_of_filters, soak_of_tracking
from torchhand.cli.benchmarks.stream import recorded_poses, recorded_stream, synthetic_stream
from torchhand.cli.benchmarks.tracking import TrackingCase, filter_update, track_memory, tracking
from torchhand.cli.benchmarks.volume import frame_cameras, octree

__all__ = [
    "Figure",
    "Peer",
    "TrackingCase",
    "crops",
    "filter_update",
    "fit_hand_bones",
    "frame_cameras",
    "keypoints_to_pose",
    "kinematics_compiled",
    "kinematics_forward",
    "kinematics_forward_backward",
    "line_of",
    "lm_iteration_jacfwd",
    "lm_iteration_pypose",
    "many_hypotheses",
    "mesh_silhouettes",
    "mesh_volume",
    "octree",
    "one_registration",
    "own_environment",
    "pose_projection",
    "recorded_poses",
    "recorded_stream",
    "skinning",
    "soak_of_filters",
    "soak_of_tracking",
    "soft_silhouettes",
    "synthetic_stream",
    "track_memory",
    "track_views",
    "track_views_memory",
    "tracking",
]
