"""Hands in motion in other programs' formats: one record that all writers take, one file per format, and readers."""

from torchhand.export.clip import Axes, MotionClip, rest_clip, write_keypoints, write_mesh_frames
from torchhand.export.conventions import (
    BapMotion,
    BvhMotion,
    bvh_names,
    clip_of_bap,
    clip_of_bvh,
    clip_of_mano,
    clip_of_openxr,
    read_bap,
    read_bvh,
    write_bap,
    write_bvh,
    write_mano,
    write_openxr,
)
from torchhand.export.formats import FORMATS, ExportOptions, Format, FormatName, format_of, write
from torchhand.export.rigged import write_glb, write_x3d
from torchhand.export.robots import LinkSolid, MjcfSettings, link_solids, write_mjcf, write_urdf
from torchhand.export.stream import StreamSettings, clip_of_stream, encode_clip, write_stream
from torchhand.export.tracked_clip import clip_of_track, load_clip

__all__ = [
    "FORMATS",
    "Axes",
    "BapMotion",
    "BvhMotion",
    "ExportOptions",
    "Format",
    "FormatName",
    "LinkSolid",
    "MjcfSettings",
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
