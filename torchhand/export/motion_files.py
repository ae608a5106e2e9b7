"""Motions in files of other programs, and in those that we write, as clips: which reader takes which file."""

import math
from dataclasses import replace
from pathlib import Path

import torch

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions import (
    clip_of_bap,
    clip_of_bvh,
    clip_of_mano,
    clip_of_openxr,
    clip_of_xr_recording,
    is_action_recording,
    is_mano_file,
    is_openxr_file,
    read_bap,
)
from torchhand.export.robots import JOINTS_SUFFIX, clip_of_joints
from torchhand.export.stream import clip_of_stream
from torchhand.files.disk import read_json
from torchhand.hand import BONES, HandModel, Side
from torchhand.hand.conventions import BoneFit

MOTION_SUFFIXES = (".bvh", ".bap", ".thp", JOINTS_SUFFIX, ".mano.npz", ".openxr.json")
_TOLD_FROM = math.radians(0.1)


def is_motion_file(path: Path) -> bool:
    """Whether a file is a motion in one of these formats and no result of tracking or hand file."""
    name = path.name.lower()
    if name.endswith(MOTION_SUFFIXES):
        return True
    if name.endswith(".npz"):
        return is_mano_file(path)
    return name.endswith(".json") and _is_recording(path)


def load_motion(path: Path, model: HandModel, shape: torch.Tensor | None, *, side: Side | None = None) -> MotionClip:
    """The clip of a file: BVH, BAP, MANO's rotations, joints of OpenXR or WebXR, joint angles, or a pose stream.

    shape: proportions of the hand; the default ones where it is None. side: where the file does not tell it. What our
    joints cannot do of a motion is told in the clip's notes.

    Raises InputError naming the file and what is wrong with it.
    """
    name = path.name.lower()
    if name.endswith(".thp"):
        return clip_of_stream(path, model)
    if name.endswith(JOINTS_SUFFIX):
        return clip_of_joints(path, model, shape)
    if name.endswith(".bap"):
        numbering = "draft" if read_bap(path).declared == "draft" else "final"
        return clip_of_bap(path, model, shape, numbering=numbering, side=side)
    if name.endswith(".bvh"):
        return _told(*clip_of_bvh(path, model, shape))
    if name.endswith(".npz"):
        return _told(*clip_of_mano(path, model, shape, side=side))
    if is_openxr_file(read_json(path)):
        return _told(*clip_of_openxr(path, model, shape))
    return _told(*clip_of_xr_recording(path, model, shape, side=side))


def _is_recording(path: Path) -> bool:
    """Whether a JSON file holds frames of hand joints; a hand file, and detections of keypoints, do not."""
    try:
        content = read_json(path)
    except InputError:
        return False
    if is_action_recording(content):
        return True
    frames = content.get("frames") if isinstance(content, dict) else content
    first = next((one for one in frames if isinstance(one, dict)), None) if isinstance(frames, list) else None
    return first is not None and "hand_world_landmarks" not in first


def _told(clip: MotionClip, fit: BoneFit) -> MotionClip:
    """The clip with a note where our joints could not follow."""
    worst = float(fit.residual.max())
    if worst < _TOLD_FROM:
        return clip
    bone = BONES[int(fit.residual.reshape(-1, len(BONES)).amax(0).argmax())]
    note = f"our joints cannot do all of the motion: {bone} is off by up to {math.degrees(worst):.1f} degrees"
    return replace(clip, notes=(*clip.notes, note))
