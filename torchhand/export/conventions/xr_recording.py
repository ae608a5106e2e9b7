"""Recordings of WebXR's and OpenXR's hand joints as other programs write them: JSON of a few common forms, read.

A recording is a list of frames, or an object with such a list under `frames`. A frame has its joints under `joints`,
`poses`, `hand`, `left`, `right`, or under `hands` by side: an object by joint names (WebXR's index-finger-phalanx-
proximal, OpenXR's index_proximal or XR_HAND_JOINT_INDEX_PROXIMAL_EXT) or a list in the order of XrHandJointEXT, with or
without the palm. A joint has `position` and `orientation` (or `rotation`, `quaternion`), lists or objects of x, y, z
(, w). Times stand under `time`, `time_s`, `t` or `timestamp` (milliseconds where they grow by more than one a frame).
The flat lists of IWER's recorder are unpacked into such frames.
"""

import math
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions.action_recording import frames_of_actions, is_action_recording
from torchhand.files.disk import read_json, read_numbers, short
from torchhand.geometry import rotation_of_quaternion
from torchhand.hand import HandModel, Side
from torchhand.hand.conventions import OPENXR_JOINTS, BoneFit, OpenXRJoints, pose_of_openxr

_TURNS = ("orientation", "rotation", "quaternion")
_TIMES = ("time_s", "time", "t", "timestamp")
_MAX_STEP_S = 1.0
_SIDES: tuple[Side, ...] = ("right", "left")


def webxr_name(joint: str) -> str:
    """WebXR's name of one of OPENXR_JOINTS (it has no palm): index-finger-phalanx-proximal for index_proximal."""
    finger, _, part = joint.partition("_")
    if not part:
        return finger
    name = {"little": "pinky"}.get(finger, finger) + ("" if finger == "thumb" else "-finger")
    return f"{name}-{part}" if part in ("metacarpal", "tip") else f"{name}-phalanx-{part}"


def clip_of_xr_recording(
    path: str | Path,
    model: HandModel,
    shape: Float64[Tensor, "shape"] | None = None,
    *,
    side: Side | None = None,
) -> tuple[MotionClip, BoneFit]:
    """The motion of a recording, and what our joints cannot do of it. Frames without the hand are left out.

    side: of the hand, where the recording has both or does not say it. Raises InputError naming what is missing.
    """
    path = Path(path)
    content = read_json(path)
    frames = content.get("frames") if isinstance(content, dict) else content
    if is_action_recording(content):
        frames = frames_of_actions(path, content)
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: expected a recording of hand joints: a list of frames, got {short(content)}")
    own = side or _told_side(content) or _only_side(path, frames)
    positions, quaternions, times, numbers = [], [], [], []
    for t, frame in enumerate(frames):
        joints = _joints(frame, own)
        if joints is None:
            continue
        where = f"{path}: frames[{t}]"
        found = [_joint(where, joints, name) for name in OPENXR_JOINTS[1:]]
        positions.append([place for place, _ in found])
        quaternions.append([turn for _, turn in found])
        times.append(_time(frame))
        numbers.append(t)
    if not numbers:
        raise InputError(f"{path}: expected joints of a {own} hand in one frame or more, got none in {len(frames)}")
    rotation = rotation_of_quaternion(_unit(path, torch.tensor(quaternions, dtype=torch.float64)))
    position = torch.tensor(positions, dtype=torch.float64)
    # The palm, which WebXR lacks, is never used: it stands where the wrist does.
    joints = OpenXRJoints(
        position=torch.cat((position[:, :1], position), 1), rotation=torch.cat((rotation[:, :1], rotation), 1)
    )
    fit = pose_of_openxr(model.kinematics(own, dtype=torch.float64), joints)
    seconds, fps = _seconds(times, content)
    clip = MotionClip(
        model=model,
        side=own,
        shape=model.shape_space.default.double() if shape is None else shape,
        poses=fit.pose,
        fps=fps,
        time_s=seconds,
        frame=tuple(numbers),
        name=path.stem,
        up="y",
    )
    return clip, fit


def _told_side(holder: Any) -> Side | None:
    said = str(holder.get("side", holder.get("handedness", ""))).lower() if isinstance(holder, dict) else ""
    return next((side for side in _SIDES if said == side), None)


def _only_side(path: Path, frames: list[Any]) -> Side:
    """The one side that frames speak of."""
    told: set[Side] = {said for frame in frames if (said := _told_side(frame)) is not None}
    for frame in frames:
        holders = (frame, frame.get("hands")) if isinstance(frame, dict) else ()
        told |= {side for side in _SIDES for one in holders if isinstance(one, dict) and one.get(side)}
    if len(told) != 1:
        got = "both" if told else "neither"
        raise InputError(f"{path}: expected the joints of one hand, left or right, got {got}; say which side it is")
    return told.pop()


def _joints(frame: Any, side: Side) -> Any:
    """The joints of that hand in a frame, by name or in a list; None where there are none."""
    if not isinstance(frame, dict) or _told_side(frame) not in (None, side):
        return None
    hands = frame.get("hands")
    chosen = next((one[side] for one in (hands, frame) if isinstance(one, dict) and one.get(side)), frame)
    for key in ("joints", "poses", "hand"):
        if isinstance(chosen, dict) and chosen.get(key):
            chosen = chosen[key]
    is_list = isinstance(chosen, list) and len(chosen) in (len(OPENXR_JOINTS), len(OPENXR_JOINTS) - 1)
    is_named = isinstance(chosen, dict) and any(name in chosen for name in _names("wrist"))
    return chosen if is_list or is_named else None


def _names(joint: str) -> tuple[str, ...]:
    return joint, webxr_name(joint), f"XR_HAND_JOINT_{joint.upper()}_EXT"


def _joint(where: str, joints: Any, name: str) -> tuple[list[float], list[float]]:
    """Position and quaternion x, y, z, w of a joint."""
    if isinstance(joints, list):
        one = joints[OPENXR_JOINTS.index(name) - (len(OPENXR_JOINTS) - len(joints))]
    else:
        one = next((joints[key] for key in _names(name) if key in joints), None)
    if not isinstance(one, dict):
        raise InputError(f"{where}: {webxr_name(name)}: expected position and orientation, got {short(one)}")
    turn = next((key for key in _TURNS if key in one), _TURNS[0])
    told = f"{where}: {webxr_name(name)}"
    return _numbers(f"{told}.position", one.get("position"), "xyz"), _numbers(f"{told}.{turn}", one.get(turn), "xyzw")


def _numbers(where: str, value: Any, letters: str) -> list[float]:
    listed = [value.get(letter) for letter in letters] if isinstance(value, dict) else value
    return read_numbers(where, listed, (len(letters),))


def _unit(path: Path, quaternion: Tensor) -> Tensor:
    lengths = quaternion.norm(dim=-1)
    if bool(((lengths - 1).abs() > 1e-2).any()):
        t, j = ((lengths - 1).abs() > 1e-2).nonzero()[0].tolist()
        raise InputError(
            f"{path}: {webxr_name(OPENXR_JOINTS[1 + j])}: expected unit quaternions, got one of length"
            f" {float(lengths[t, j]):g}"
        )
    return quaternion / lengths[..., None]


def _time(frame: dict[str, Any]) -> float | None:
    found = next((frame[key] for key in _TIMES if key in frame), None)
    if isinstance(found, int | float) and not isinstance(found, bool) and math.isfinite(found):
        return float(found)
    return None


def _seconds(times: list[float | None], content: Any) -> tuple[tuple[float, ...], float]:
    """Times of the frames and their rate; by the recording's `fps`, else 30, where frames have none that grow."""
    told = content.get("fps") if isinstance(content, dict) else None
    fps = float(told) if isinstance(told, int | float) and not isinstance(told, bool) and 0 < told <= 1e6 else 30.0
    known = [time for time in times if time is not None]
    gaps = torch.tensor(known, dtype=torch.float64).diff()
    if len(known) < max(2, len(times)) or not bool((gaps > 0).all()):
        return (), fps
    scale = 1e-3 if float(gaps.median()) > _MAX_STEP_S else 1.0
    return tuple(scale * (time - known[0]) for time in known), float(1 / (scale * gaps.median()))
