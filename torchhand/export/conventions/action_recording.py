"""Recordings of IWER, the emulator and recorder of WebXR's inputs, unpacked into frames of named hand joints.

A recording has a `schema`, pairs of an input's number and what it has, and `frames`, flat lists: the time in
milliseconds, the viewer's position and quaternion, then a list for each input that is seen: its number, position and
quaternion of its target ray, and as the schema says position and quaternion of its grip (a list), eight numbers per
joint (a list: position, quaternion, radius; in the frame of the target ray), and its buttons. Its recorder rounds
numbers to 0.001.
"""

from pathlib import Path
from typing import Any

import torch

from torchhand.errors import InputError
from torchhand.files.disk import read_number, read_numbers, short
from torchhand.geometry import quaternion_of_rotation, rotation_of_quaternion

_HEADER = 8  # numbers before the inputs of a frame, and before the lists of an input
_PER_JOINT = 8


def is_action_recording(content: Any) -> bool:
    """Whether the content of a JSON file is such a recording."""
    return isinstance(content, dict) and isinstance(content.get("schema"), list) and "frames" in content


def frames_of_actions(path: Path, content: dict[str, Any]) -> list[dict[str, Any]]:
    """The frames, each with its `time` (milliseconds) and `hands`: the joints of each side by WebXR's names, in the
    frame of the recording.

    Raises InputError naming what is not as the schema says.
    """
    schema = _hands_of_schema(path, content["schema"])
    found = []
    for t, frame in enumerate(content["frames"] if isinstance(content["frames"], list) else []):
        where = f"{path}: frames[{t}]"
        if not isinstance(frame, list) or len(frame) < _HEADER:
            raise InputError(f"{where}: expected a time, the viewer's pose and inputs, got {short(frame)}")
        hands = {}
        for one in frame[_HEADER:]:
            if not isinstance(one, list) or len(one) < _HEADER:
                raise InputError(f"{where}: expected an input's number and pose, got {short(one)}")
            if one[0] in schema:
                hand = schema[one[0]]
                hands[hand["handedness"]] = _joints(f"{where}, input {one[0]}", one, hand)
        found.append({"time": read_number(f"{where}[0]", frame[0]), "hands": hands})
    return found


def _hands_of_schema(path: Path, schema: list[Any]) -> dict[Any, dict[str, Any]]:
    """What the inputs are that have joints, by their numbers."""
    hands = {}
    for entry in schema:
        is_entry = isinstance(entry, list) and len(entry) == 2 and isinstance(entry[1], dict)
        if not is_entry or not isinstance(entry[0], int):
            raise InputError(f"{path}: schema: expected pairs of a number and an object, got {short(entry)}")
        number, one = entry
        if not one.get("hasHand"):
            continue
        names = one.get("jointSequence")
        if not isinstance(names, list) or one.get("handedness") not in ("left", "right"):
            raise InputError(
                f"{path}: schema: expected handedness left or right and a jointSequence of input {number}, got"
                f" {short(one.get('handedness'))} and {short(names)}"
            )
        hands[number] = one
    return hands


def _joints(where: str, one: list[Any], hand: dict[str, Any]) -> dict[str, dict[str, list[float]]]:
    """The joints of an input of a frame, out of the frame of its target ray."""
    names = hand["jointSequence"]
    place = _HEADER + bool(hand.get("hasGrip"))
    listed = one[place] if place < len(one) else None
    numbers = read_numbers(f"{where}: joints", listed, (_PER_JOINT * len(names),))
    joints = torch.tensor(numbers, dtype=torch.float64).reshape(-1, _PER_JOINT)
    ray = torch.tensor(read_numbers(f"{where}: target ray", one[1:_HEADER], (_HEADER - 1,)), dtype=torch.float64)
    for quaternion in (ray[3:], *joints[:, 3:7]):
        if float(quaternion.norm()) < 0.5:  # rounded to 0.001, a unit quaternion is one to 0.001
            raise InputError(f"{where}: expected unit quaternions, got {short(quaternion.tolist())}")
    world_from_ray = rotation_of_quaternion(ray[3:])
    positions = joints[:, :3] @ world_from_ray.mT + ray[:3]
    turns = quaternion_of_rotation(world_from_ray @ rotation_of_quaternion(joints[:, 3:7]))
    return {
        name: {"position": position, "orientation": turn}
        for name, position, turn in zip(names, positions.tolist(), turns.tolist(), strict=True)
    }
