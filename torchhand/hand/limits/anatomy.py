"""The anatomy that `torchhand build_hand` writes into hand.urdf: resting directions, joint axes, limits."""

import math

import torch
from torch import Tensor

from torchhand.geometry import rotation_from_vector
from torchhand.hand.kinematics import (
    BONES,
    FINGERS,
    JOINT_DOFS,
    PARENTS,
    ShapeSpace,
    Skeleton,
    bone_offsets,
    joint_positions,
)

# Direction of each straight finger in the palm plane, degrees towards the thumb from the middle finger (the
# metacarpals fan out more than the fingers do, which lie nearly parallel when the abductions are zero).
_FINGER_FAN_DEG = {"index": 2.0, "middle": 0.0, "ring": -2.0, "little": -6.0}
# Roll of each finger's flexion plane about the finger: flexed fingertips converge towards the thumb's base.
_FINGER_ROLL_DEG = {"index": -5.0, "middle": 0.0, "ring": 8.0, "little": 15.0}
# Thumb metacarpal at zero angles lies beside the index: tilted towards the thumb's side and out of the palm.
_THUMB_RADIAL_DEG, _THUMB_PALMAR_DEG = 28.0, 12.0
# Its abduction plane is oblique, half way between the palm's plane and the perpendicular one.
_THUMB_OBLIQUE_DEG = 45.0
# Angle between the CMC joint's two axes, measured in vivo (Chang and Pollard 2008).
_THUMB_AXES_SKEW_DEG = 87.0

_LIMITS_DEG = {
    # Between the norms of the AAOS and the limits of published hand models; radial CMC joints move little.
    "thumb_cmc_fe": (-25, 80),
    "thumb_cmc_aa": (0, 60),
    "thumb_cmc_tw": (-20, 40),
    "thumb_mcp_fe": (-10, 65),
    "thumb_mcp_aa": (-15, 15),
    "thumb_ip_fe": (-20, 85),
    "mcp_fe": (-15, 100),
    "mcp_aa": (-20, 20),
    "mcp_tw": (-10, 10),
    "pip_fe": (-5, 110),
    "dip_fe": (-10, 90),
    "index_cmc_fe": (0, 5),
    "middle_cmc_fe": (0, 5),
    "ring_cmc_fe": (0, 15),
    "little_cmc_fe": (0, 25),
    "middle_mcp_aa": (-12, 12),
    # the outer fingers spread further than the recommended ±20: 30 to 42 and 30 to 35 in published models
    "index_mcp_aa": (-20, 30),
    "little_mcp_aa": (-20, 35),
}

_ORDER = {"aa": 0, "fe": 1, "tw": 2}  # abduction outside flexion (Ouhaddi and Horain 1998, equation 7), twist innermost
_JOINT_BONE = {"cmc": "metacarpal", "mcp": "proximal", "pip": "middle", "dip": "distal", "ip": "distal"}


def _turn(axis: tuple[float, float, float], angle_deg: float) -> Tensor:
    return rotation_from_vector(torch.tensor(axis, dtype=torch.float64) * math.radians(angle_deg))


_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def _hand_from_bone(space: ShapeSpace) -> dict[str, Tensor]:
    """Orientation of every bone in the hand frame at zero angles and default shape."""
    bases, knuckles = joint_positions(space, space.default.double()).unbind(0)
    frames = {"wrist": torch.eye(3, dtype=torch.float64)}
    for i, finger in enumerate(FINGERS):
        if finger == "thumb":
            # z of the thumb's frame, the side it abducts to, points towards the thumb's side and out of the palm.
            thumb = _turn(_X, _THUMB_RADIAL_DEG) @ _turn(_Z, _THUMB_PALMAR_DEG) @ _turn(_Y, -_THUMB_OBLIQUE_DEG)
            frames |= {f"thumb_{bone}": thumb for bone in ("metacarpal", "proximal", "distal")}
            continue
        direction = knuckles[i] - bases[i]
        fan_deg = math.degrees(math.atan2(float(direction[2]), float(direction[1])))
        rise_deg = math.degrees(math.atan2(-float(direction[0]), float(direction[1:].norm())))
        frames[f"{finger}_metacarpal"] = _turn(_X, fan_deg) @ _turn(_Z, rise_deg)
        straight = _turn(_X, _FINGER_FAN_DEG[finger]) @ _turn(_Y, _FINGER_ROLL_DEG[finger])
        frames |= {f"{finger}_{bone}": straight for bone in ("proximal", "middle", "distal")}
    return frames


def _axis(dof: str) -> tuple[float, float, float]:
    """Joint axis in the frame of the bone that moves."""
    if dof == "thumb_cmc_fe":
        skew = math.radians(_THUMB_AXES_SKEW_DEG)
        return (math.cos(skew), 0.0, math.sin(skew))
    role = dof.rsplit("_", 1)[1]
    if role == "fe":
        return _Z
    if role == "tw":
        return _Y
    # Positive abduction leads away from the middle finger; the middle finger's own, and the thumb's, lead radially.
    return (-1.0, 0.0, 0.0) if dof.startswith(("ring", "little")) else _X


def _limit_deg(dof: str) -> tuple[int, int]:
    return _LIMITS_DEG[dof] if dof in _LIMITS_DEG else _LIMITS_DEG[dof.split("_", 1)[1]]


def anatomical_skeleton(space: ShapeSpace) -> Skeleton:
    """The generic right hand's skeleton, float64."""
    frames = _hand_from_bone(space)
    rest = [torch.eye(3, dtype=torch.float64)]
    rest += [frames[BONES[PARENTS[i]]].T @ frames[BONES[i]] for i in range(1, len(BONES))]
    rest_rotation = torch.stack(rest)
    offsets, tips = bone_offsets(space, space.default.double(), rest_rotation[1:6])
    bones = [BONES.index(f"{dof.split('_')[0]}_{_JOINT_BONE[dof.split('_')[1]]}") for dof in JOINT_DOFS]
    limits = torch.deg2rad(torch.tensor([_limit_deg(dof) for dof in JOINT_DOFS], dtype=torch.float64))
    return Skeleton(
        rest_rotation=rest_rotation,
        rest_offset=offsets,
        tip_offset=tips,
        axis=torch.tensor([_axis(dof) for dof in JOINT_DOFS], dtype=torch.float64),
        bone=tuple(bones),
        order=tuple(_ORDER[dof.rsplit("_", 1)[1]] for dof in JOINT_DOFS),
        lower=limits[:, 0],
        upper=limits[:, 1],
    )
