"""Motion as BVH (Biovision hierarchy) text: skeleton and joint angles, no skin.

Frame: y up, z forward; centimetres and degrees. At zero angles the hand is ours with all angles zero and the joints'
axes are parallel to the hand frame: x out of the back of the hand, y towards the fingers. The root has six channels, a
joint three, its rotation being Rz · Rx · Ry. Fingertips are End Sites. The format has one rate and no comments: poses
of uneven times are interpolated to it, and the numbers of held frames stand in NAME.held.json beside the file.
"""

import json
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.export.clip import MotionClip
from torchhand.export.conventions.bvh_names import BvhNames, bvh_names
from torchhand.files.disk import write_text
from torchhand.hand import BONES, FINGERS, PARENTS
from torchhand.hand.conventions import bone_turns, rest_rotations

CENTIMETRES = 100.0
_DIGITS = 6


def write_bvh(clip: MotionClip, path: str | Path, *, names: BvhNames = "torchhand") -> None:
    """Write the file; joints are named as `bvh_names` says."""
    upright = clip.at_constant_rate().placed("y-up")
    rest = rest_rotations(upright.kinematics)
    lines = ["HIERARCHY", *_joint(upright, 0, bvh_names(clip.side, names), rest, "")]
    angles = torch.rad2deg(zxy_angles(bone_turns(upright.frames.rotation, rest)))
    angles = torch.from_numpy(np.unwrap(angles.numpy(), period=360.0, axis=0))
    rows = torch.cat((CENTIMETRES * upright.frames.position[:, :1], angles[:, _depth_first()]), 1).flatten(1)
    lines += ["MOTION", f"Frames: {len(upright)}", f"Frame Time: {1 / clip.fps:.9g}"]
    lines += [" ".join(_number(value) for value in row) for row in rows.tolist()]
    write_text(Path(path), "\n".join(lines) + "\n")
    if upright.held:
        places = [place for place, is_own in enumerate(upright.is_own) if not is_own]
        write_text(held_path(Path(path)), json.dumps({"held": places, "fps": clip.fps}) + "\n")


def held_path(path: Path) -> Path:
    """The file beside a BVH file that lists its held frames, by their places."""
    return path.with_suffix(".held.json")


def zxy_angles(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """(z, x, y) with Rz · Rx · Ry = rotation, radians; where z and y turn about one line, y is 0."""
    middle = torch.asin(rotation[..., 2, 1].clamp(-1, 1))
    first = torch.atan2(-rotation[..., 0, 1], rotation[..., 1, 1])
    last = torch.atan2(-rotation[..., 2, 0], rotation[..., 2, 2])
    is_degenerate = torch.hypot(rotation[..., 0, 1], rotation[..., 1, 1]) < 1e-9
    alone = torch.atan2(rotation[..., 1, 0], rotation[..., 0, 0])
    first = torch.where(is_degenerate, alone, first)
    last = torch.where(is_degenerate, torch.zeros_like(last), last)
    return torch.stack((first, middle, last), -1)


def _joint(clip: MotionClip, bone: int, names: tuple[str, ...], rest: Tensor, indent: str) -> list[str]:
    parent = PARENTS[bone]
    offset = clip.skeleton.rest_offset[bone] if parent < 0 else rest[parent] @ clip.skeleton.rest_offset[bone]
    position = "Xposition Yposition Zposition " if parent < 0 else ""
    lines = [
        f"{indent}{'ROOT' if parent < 0 else 'JOINT'} {names[bone]}",
        f"{indent}{{",
        f"{indent}\tOFFSET {_offset(offset)}",
        f"{indent}\tCHANNELS {6 if position else 3} {position}Zrotation Xrotation Yrotation",
    ]
    children = [child for child, own in enumerate(PARENTS) if own == bone]
    for child in children:
        lines += _joint(clip, child, names, rest, indent + "\t")
    if not children:
        tip = rest[bone] @ clip.skeleton.tip_offset[FINGERS.index(BONES[bone].split("_")[0])]
        lines += [f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET {_offset(tip)}", f"{indent}\t}}"]
    return [*lines, f"{indent}}}"]


def _depth_first(bone: int = 0) -> list[int]:
    """Bones in the order in which the hierarchy names them."""
    children = (child for child, own in enumerate(PARENTS) if own == bone)
    return [bone, *(inner for child in children for inner in _depth_first(child))]


def _offset(metres: Tensor) -> str:
    return " ".join(_number(CENTIMETRES * value) for value in metres.tolist())


def _number(value: float) -> str:
    return f"{round(value, _DIGITS) + 0.0:.{_DIGITS}f}"
