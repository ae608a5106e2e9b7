"""What the page draws of one result: the frames' numbers, and the hand that it poses with them."""

import math
from typing import Any

import numpy as np
import torch

from torchhand.files.results import DETERMINED, STATUSES
from torchhand.geometry import continuous, quaternion_of_rotation, rotation_from_vector
from torchhand.hand import JOINT_DOFS, PARENTS, ROOT_DOFS
from torchhand.hand.kinematics import sided_skeleton
from torchhand.report.packing import packed, packed_range
from torchhand.report.result import Result

MAX_FRAMES = 18_000
"""Frames that a page holds: 10 minutes at 30 a second. Of a longer track every second one, or third ..."""
ANGLE_STEP_DEG = 0.01
_QUATERNION_STEP = 1 / 32767
_POSITION_STEP = 2e-5  # metres
_QUALITY_STEP = 1 / 200
_TIME_STEP = 1e-4  # seconds
_FIRST = len(ROOT_DOFS)


def frame_stride(result: Result) -> int:
    """Every how many-th frame a page holds."""
    return max(1, math.ceil(len(result.track) / MAX_FRAMES))


def content_of(result: Result) -> dict[str, Any]:
    """Values that JSON knows; arrays packed."""
    track, rows = result.track, slice(None, None, frame_stride(result))
    pose = torch.from_numpy(track.pose[rows].astype(np.float64))
    known = torch.from_numpy(track.has_hand[rows])
    turn = torch.full((len(pose), 4), math.nan, dtype=torch.float64)
    if bool(known.any()):
        turn[known] = continuous(quaternion_of_rotation(rotation_from_vector(pose[known, 3:_FIRST])))
    std = np.rad2deg(track.pose_std[rows, _FIRST:])
    time_s = track.frame / result.fps if track.time_s is None else track.time_s
    content = {
        "name": result.name,
        "side": result.side,
        "time": packed(time_s[rows], "i4", step=_TIME_STEP),
        "frame": packed(track.frame[rows], "i4"),
        "status": packed(np.array([STATUSES.index(status) for status in track.status[rows]]), "u1"),
        "statuses": [status.replace("_", " ") for status in STATUSES],
        "position": packed_range(track.pose[rows, :3], step=_POSITION_STEP),
        "rotation": packed(turn.numpy(), "i2", step=_QUATERNION_STEP),
        "angles": packed(np.rad2deg(track.pose[rows, _FIRST:]), "i2", step=ANGLE_STEP_DEG),
        "std": packed(std.clip(max=320.0), "i2", step=ANGLE_STEP_DEG),
        "quality": None,
        "determined": DETERMINED,
        "names": list(JOINT_DOFS),
        "is_free": [name in free_angles(result) for name in JOINT_DOFS],
        "view": _view_from_world(result),
        "hand": _hand(result),
    }
    if track.finger_quality is not None:
        content["quality"] = packed(track.finger_quality[rows], "u1", step=_QUALITY_STEP)
    return content


def free_angles(result: Result) -> set[str]:
    """Names of the joint angles that were estimated: those of which a page would show a standard deviation."""
    std = np.nan_to_num(np.rad2deg(result.track.pose_std[:, _FIRST:])).max(0, initial=0.0)
    return {name for name, largest in zip(JOINT_DOFS, std, strict=True) if largest >= ANGLE_STEP_DEG}


def _view_from_world(result: Result) -> list[float]:
    """Rotation of the first camera, by rows."""
    cameras = result.track.cameras
    rotation = np.asarray(cameras[0].get("R", np.eye(3)) if cameras else np.eye(3), dtype=np.float64)
    return rotation.reshape(9).tolist() if rotation.size == 9 else np.eye(3).reshape(9).tolist()


def _hand(result: Result) -> dict[str, Any]:
    """The skeleton of this person's hand, and its skin at the pose in which it was made."""
    skeleton = sided_skeleton(
        result.model.skeleton.to(dtype=torch.float64), result.side, space=result.model.shape_space, shape=result.shape
    )
    axis = skeleton.axis / skeleton.axis.norm(dim=1, keepdim=True)
    hand = result.model.hand(result.shape, side=result.side, dtype=torch.float64)
    skin, mesh = hand.skinning, result.model.mesh
    assert mesh is not None
    metres = hand.kinematics.metres(result.shape)
    correctives = skin.correctives.permute(3, 0, 1, 2)  # (V, C, 2, 3)
    rest = (skin.rest_vertices + skin.rest_basis @ metres).T
    return {
        "parents": list(PARENTS),
        "rest_rotation": skeleton.rest_rotation.reshape(-1).tolist(),
        "rest_offset": skeleton.rest_offset.reshape(-1).tolist(),
        "tip_offset": skeleton.tip_offset.reshape(-1).tolist(),
        "axis": axis.reshape(-1).tolist(),
        "bone": list(skeleton.bone),
        "order": list(skeleton.order),
        "lower": torch.rad2deg(skeleton.lower).tolist(),
        "upper": torch.rad2deg(skeleton.upper).tolist(),
        "faces": packed(hand.faces.numpy(), "i2"),
        "vertices": packed_range(rest.numpy(), step=5e-6),
        "skin_bones": packed(mesh.skin_bones.numpy(), "u1"),
        "skin_weights": packed(mesh.skin_weights.numpy(), "i2", step=1 / 32767),
        "bone_from_hand": skin.bone_from_hand.reshape(-1).tolist(),
        "bone_origin": (skin.origin_basis @ metres).reshape(-1).tolist(),
        "correctives": packed_range(correctives.flatten(1).numpy(), step=5e-6),
        "corrective_bones": skin.corrective_bones.tolist(),
        "corrective_angles": (skin.corrective_rows - _FIRST).tolist(),
        "corrective_zero": torch.rad2deg(skin.corrective_zero[:, 0]).tolist(),
        "breadth": float(skin.breadth_scale @ metres),
    }
