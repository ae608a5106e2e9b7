"""Names of H-Anim (ISO/IEC 19774) for our bones: joints and the segments that they move."""

from typing import Literal

from torchhand.hand.kinematics import BONES, FINGERS, Side

HAnimVersion = Literal["2", "1"]

_JOINTS_2 = {"metacarpal": "carpometacarpal", "proximal": "metacarpophalangeal"}
_JOINTS_2 |= {"middle": "carpal_proximal_interphalangeal", "distal": "carpal_distal_interphalangeal"}
_LEVELS_1 = {"metacarpal": 0, "proximal": 1, "middle": 2, "distal": 3}


def hanim_joints(side: Side, version: HAnimVersion = "2") -> tuple[str, ...]:
    """Name of the joint at the beginning of each bone, in the order of BONES.

    Version 2 counts the digits, thumb 1 to little 5: r_metacarpophalangeal_2. Version 1 names them: r_index1.
    """
    prefix = "l_" if side == "left" else "r_"
    return tuple(prefix + (_joint_2(bone) if version == "2" else _joint_1(bone)) for bone in BONES)


def hanim_segments(side: Side) -> tuple[str, ...]:
    """Name of the segment that each bone is, version 2, in the order of BONES."""
    return tuple(("l_" if side == "left" else "r_") + _segment(bone) for bone in BONES)


def _joint_2(bone: str) -> str:
    if bone == "wrist":
        return "radiocarpal"
    finger, level = bone.split("_")
    if bone == "thumb_distal":
        return "carpal_interphalangeal_1"
    return f"{_JOINTS_2[level]}_{FINGERS.index(finger) + 1}"


def _joint_1(bone: str) -> str:
    if bone == "wrist":
        return bone
    finger, level = bone.split("_")
    if finger == "thumb":
        return f"thumb{('metacarpal', 'proximal', 'distal').index(level) + 1}"
    return f"{'pinky' if finger == 'little' else finger}{_LEVELS_1[level]}"


def _segment(bone: str) -> str:
    if bone == "wrist":
        return "carpal"
    finger, level = bone.split("_")
    number = FINGERS.index(finger) + 1
    return f"metacarpal_{number}" if level == "metacarpal" else f"carpal_{level}_phalanx_{number}"
