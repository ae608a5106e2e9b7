"""A hand in motion as one record, and its plain arrays."""

from torchhand.export.clip.angle_file import ANGLE_SUFFIX, write_angles
from torchhand.export.clip.keypoint_file import KEYPOINT_SUFFIXES, write_keypoints
from torchhand.export.clip.mesh_frames import mesh_paths, write_mesh_frames
from torchhand.export.clip.motion_clip import MAX_GAP_S, MISSING, Axes, MotionClip, Up, check_max_gap, rest_clip
from torchhand.export.clip.texture import texture_atlas

__all__ = [
    "ANGLE_SUFFIX",
    "KEYPOINT_SUFFIXES",
    "MAX_GAP_S",
    "MISSING",
    "Axes",
    "MotionClip",
    "Up",
    "check_max_gap",
    "mesh_paths",
    "rest_clip",
    "texture_atlas",
    "write_angles",
    "write_keypoints",
    "write_mesh_frames",
]
