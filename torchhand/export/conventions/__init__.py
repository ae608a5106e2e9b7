"""Motions in the conventions of others: BVH, MPEG-4 body animation parameters, MANO, OpenXR."""

from torchhand.export.conventions.action_recording import is_action_recording
from torchhand.export.conventions.bap import BapMotion, BapVersion, clip_of_bap, read_bap, write_bap
from torchhand.export.conventions.bvh import held_path, write_bvh
from torchhand.export.conventions.bvh_names import BvhNames, bvh_names
from torchhand.export.conventions.bvh_reader import BvhMotion, clip_of_bvh, read_bvh
from torchhand.export.conventions.mano import clip_of_mano, is_mano_file, write_mano
from torchhand.export.conventions.openxr import clip_of_openxr, is_openxr_file, write_openxr
from torchhand.export.conventions.xr_recording import clip_of_xr_recording, webxr_name

__all__ = [
    "BapMotion",
    "BapVersion",
    "BvhMotion",
    "BvhNames",
    "bvh_names",
    "clip_of_bap",
    "clip_of_bvh",
    "clip_of_mano",
    "clip_of_openxr",
    "clip_of_xr_recording",
    "held_path",
    "is_action_recording",
    "is_mano_file",
    "is_openxr_file",
    "read_bap",
    "read_bvh",
    "webxr_name",
    "write_bap",
    "write_bvh",
    "write_mano",
    "write_openxr",
]
