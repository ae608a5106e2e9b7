"""Poses of OpenXR's 26 hand joints as JSON, written and read.

{"format": "torchhand openxr 1", "side", "fps", "joints": [26 names], "frames": [{"frame", "time", "held", "poses": [26
of {"position": [x, y, z], "orientation": [x, y, z, w], "radius"}]}]}: what xrLocateHandJointsEXT returns, frame by
frame, in a space as OpenXR's unless other axes are asked for: metres, y up, -z forward.
"""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.files.disk import read_json, read_number, read_numbers, short, write_text
from torchhand.geometry import continuous, quaternion_of_rotation, rotation_of_quaternion
from torchhand.hand import HandModel
from torchhand.hand.conventions import OPENXR_JOINTS, BoneFit, OpenXRJoints, openxr_joints, openxr_radii, pose_of_openxr

OPENXR_FORMAT = "torchhand openxr 1"
_UNIT_LENGTH_SLACK = 1e-3


def write_openxr(clip: MotionClip, path: str | Path) -> None:
    """Write the file."""
    upright = clip.placed("y-up")
    joints = openxr_joints(upright.frames)
    quaternions = continuous(quaternion_of_rotation(joints.rotation)).tolist()
    positions = joints.position.tolist()
    seconds = clip.seconds.tolist()
    radii = openxr_radii(clip.model.shape_space, clip.shape).tolist()
    frames = [
        {
            "frame": clip.frame[t],
            "time": seconds[t],
            "held": not clip.is_own[t],
            "poses": [
                {"position": positions[t][j], "orientation": quaternions[t][j], "radius": radii[j]}
                for j in range(len(OPENXR_JOINTS))
            ],
        }
        for t in range(len(clip))
    ]
    content = {"format": OPENXR_FORMAT, "side": clip.side, "fps": clip.fps, "joints": OPENXR_JOINTS, "frames": frames}
    write_text(Path(path), json.dumps(content, allow_nan=False) + "\n")


def is_openxr_file(content: Any) -> bool:
    """Whether the content of a JSON file is of the form that `write_openxr` writes."""
    return isinstance(content, dict) and content.get("format") == OPENXR_FORMAT


def clip_of_openxr(
    path: str | Path, model: HandModel, shape: Float64[Tensor, "shape"] | None = None
) -> tuple[MotionClip, BoneFit]:
    """The motion of a file, and what our joints cannot do of it. Of the places only the wrist's is used.

    Raises InputError naming the key, what was expected and what was got.
    """
    path = Path(path)
    content = read_json(path)
    if not isinstance(content, dict) or content.get("format") != OPENXR_FORMAT:
        got = content.get("format", "a file without 'format'") if isinstance(content, dict) else content
        raise InputError(f"{path}: expected joints of OpenXR ('format': '{OPENXR_FORMAT}'), got {short(got)}")
    side = content.get("side")
    if side not in ("left", "right"):
        raise InputError(f"{path}: side: expected left or right, got {short(side)}")
    fps = read_number(f"{path}: fps", content.get("fps"))
    if not 0 < fps <= 1e6:
        raise InputError(f"{path}: fps: expected more than 0, 1e6 at most, got {fps:g}")
    if content.get("joints") != list(OPENXR_JOINTS):
        raise InputError(f"{path}: joints: expected the {len(OPENXR_JOINTS)} of OpenXR in its order, got others")
    frames = content.get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: frames: expected a list of one frame or more, got {short(frames)}")
    positions, quaternions, numbers, held, times = [], [], [], [], []
    for t, frame in enumerate(frames):
        where = f"{path}: frames[{t}]"
        poses = frame.get("poses") if isinstance(frame, dict) else None
        if not isinstance(poses, list) or len(poses) != len(OPENXR_JOINTS):
            got = len(poses) if isinstance(poses, list) else short(poses)
            raise InputError(f"{where}.poses: expected a list of {len(OPENXR_JOINTS)}, got {got}")
        positions.append([_vector(where, poses, j, "position", 3) for j in range(len(poses))])
        quaternions.append([_vector(where, poses, j, "orientation", 4) for j in range(len(poses))])
        numbers.append(int(read_number(f"{where}.frame", frame.get("frame", t))))
        held += [numbers[-1]] if frame.get("held") is True else []
        times.append(read_number(f"{where}.time", frame.get("time", t / fps)))
    quaternion = torch.tensor(quaternions, dtype=torch.float64)
    lengths = quaternion.norm(dim=-1)
    if bool(((lengths - 1).abs() > _UNIT_LENGTH_SLACK).any()):
        t, j = ((lengths - 1).abs() > _UNIT_LENGTH_SLACK).nonzero()[0].tolist()
        raise InputError(
            f"{path}: frames[{t}].poses[{j}].orientation: expected a unit quaternion,"
            f" got length {float(lengths[t, j]):g}"
        )
    joints = OpenXRJoints(
        position=torch.tensor(positions, dtype=torch.float64), rotation=rotation_of_quaternion(quaternion)
    )
    fit = pose_of_openxr(model.kinematics(side, dtype=torch.float64), joints)
    clip = MotionClip(
        model=model,
        side=side,
        shape=model.shape_space.default.double() if shape is None else shape,
        poses=fit.pose,
        fps=fps,
        time_s=tuple(times) if all(one < other for one, other in pairwise(times)) else (),
        frame=tuple(numbers),
        held=tuple(held),
        name=path.stem,
        up="y",
    )
    return clip, fit


def _vector(where: str, poses: list[Any], joint: int, key: str, count: int) -> list[float]:
    pose = poses[joint]
    if not isinstance(pose, dict):
        raise InputError(f"{where}.poses[{joint}]: expected position and orientation, got {short(pose)}")
    return read_numbers(f"{where}.poses[{joint}].{key}", pose.get(key), (count,))
