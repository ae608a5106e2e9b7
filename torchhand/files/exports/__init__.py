"""Hands in motion in other programs' formats: one record that all writers take, one file per format, and readers."""

from torchhand.files.exports.bap import BapMotion, clip_of_bap, read_bap, write_bap
from torchhand.files.exports.bvh import write_bvh
from torchhand.files.exports.bvh_names import bvh_names
from torchhand.files.exports.bvh_reader import BvhMotion, clip_of_bvh, read_bvh
from torchhand.files.exports.formats import FORMATS, ExportOptions, Format, FormatName, format_of, write
from torchhand.files.exports.glb import write_glb
from torchhand.files.exports.keypoint_file import write_keypoints
from torchhand.files.exports.link_solids import LinkSolid, link_solids
from torchhand.files.exports.mano_file import clip_of_mano, write_mano
from torchhand.files.exports.mesh_frames import write_mesh_frames
from torchhand.files.exports.mjcf import write_mjcf
from torchhand.files.exports.motion_clip import MotionClip, rest_clip
from torchhand.files.exports.openxr_file import clip_of_openxr, write_openxr
from torchhand.files.exports.pose_stream import StreamSettings, clip_of_stream, encode_clip, write_stream
from torchhand.files.exports.robot_urdf import write_urdf
from torchhand.files.exports.tracked_clip import clip_of_track, load_clip
from torchhand.files.exports.x3d import write_x3d

__all__ = [
    "FORMATS",
    "BapMotion",
    "BvhMotion",
    "ExportOptions",
    "Format",
    "FormatName",
    "LinkSolid",
    "MotionClip",
    "StreamSettings",
    "bvh_names",
    "clip_of_bap",
    "clip_of_bvh",
    "clip_of_mano",
    "clip_of_openxr",
    "clip_of_stream",
    "clip_of_track",
    "encode_clip",
    "format_of",
    "link_solids",
    "load_clip",
    "read_bap",
    "read_bvh",
    "rest_clip",
    "write",
    "write_bap",
    "write_bvh",
    "write_glb",
    "write_keypoints",
    "write_mano",
    "write_mesh_frames",
    "write_mjcf",
    "write_openxr",
    "write_stream",
    "write_urdf",
    "write_x3d",
]
