"""The hand's skeleton as a URDF file, written by `build_hand` and read through pytorch-kinematics."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchhand.errors import InputError
from torchhand.geometry import ordered_product
from torchhand.hand import BONES, FINGERS, JOINT_DOFS, PARENTS, Skeleton

_DIGITS = 12
_NEWTON_STEPS = 3  # the error's square in each: from 1e-7 on, two reach float64's last bits


def skeleton_to_urdf(skeleton: Skeleton, name: str) -> str:
    """The skeleton as URDF text: one revolute joint per angle named as its DOF, links named as the bones.

    The bone's offset and resting rotation stand in the origin of its outermost joint; links between the joints of one
    bone are called BONE_DOF. Fingertip keypoints are fixed joints.
    """
    lines = ['<?xml version="1.0"?>', f'<robot name="{name}">', f'  <link name="{BONES[0]}"/>']
    for i in range(1, len(BONES)):
        angles = sorted((j for j in range(len(JOINT_DOFS)) if skeleton.bone[j] == i), key=lambda j: skeleton.order[j])
        parent = BONES[PARENTS[i]]
        for place, j in enumerate(angles):
            child = BONES[i] if place == len(angles) - 1 else f"{BONES[i]}_{JOINT_DOFS[j]}"
            origin = _origin(skeleton.rest_offset[i], skeleton.rest_rotation[i]) if place == 0 else ""
            lower, upper = f"{skeleton.lower[j]:.{_DIGITS}f}", f"{skeleton.upper[j]:.{_DIGITS}f}"
            limit = f'lower="{lower}" upper="{upper}" effort="0" velocity="0"'
            lines += [
                f'  <link name="{child}"/>',
                f'  <joint name="{JOINT_DOFS[j]}" type="revolute">',
                f'    <parent link="{parent}"/><child link="{child}"/>{origin}',
                f'    <axis xyz="{_numbers(skeleton.axis[j])}"/><limit {limit}/>',
                "  </joint>",
            ]
            parent = child
    straight = torch.eye(3, dtype=skeleton.tip_offset.dtype)
    for finger, bone, offset in zip(FINGERS, _tip_bones(), skeleton.tip_offset, strict=True):
        lines += [
            f'  <link name="{finger}_tip"/>',
            f'  <joint name="{finger}_tip_fixed" type="fixed">',
            f'    <parent link="{bone}"/><child link="{finger}_tip"/>{_origin(offset, straight)}',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>", ""])


def read_skeleton(path: Path) -> Skeleton:
    """The skeleton of a URDF file with our bone and joint names, float64. Raises InputError for any other robot."""
    import pytorch_kinematics  # 0.7 s, which a model with its skeleton.npz need not wait for

    try:
        # As bytes: the parser refuses text with an encoding declaration.
        chain = pytorch_kinematics.build_chain_from_urdf(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except Exception as error:  # the parser raises whatever it stumbles over
        raise InputError(f"{path}: is no URDF file ({' '.join(str(error).split())})") from error
    frames = {frame.link.name: frame for frame in _walk(chain._root)}
    joints = {frame.joint.name: frame for frame in frames.values()}
    missing = [name for name in BONES if name not in frames] + [name for name in JOINT_DOFS if name not in joints]
    missing += [f"{finger}_tip" for finger in FINGERS if f"{finger}_tip" not in frames]
    if missing:
        raise InputError(f"{path}: expected the links and joints of a torchhand hand, lacks {', '.join(missing)}")
    try:
        skeleton = _skeleton_of(frames)
    except (KeyError, TypeError, ValueError) as error:
        told = f"{type(error).__name__}: {error}"
        raise InputError(f"{path}: expected the links of a torchhand hand one below the other ({told})") from error
    return skeleton


def _skeleton_of(frames: dict[str, Any]) -> Skeleton:
    """Raises KeyError, TypeError or ValueError where links do not hang together as a hand's, or numbers are none."""
    joints = {frame.joint.name: frame for frame in frames.values()}
    parents = {child.link.name: frame for frame in frames.values() for child in frame.children}
    rest_rotation = torch.eye(3, dtype=torch.float64).repeat(len(BONES), 1, 1)
    rest_offset = torch.zeros(len(BONES), 3, dtype=torch.float64)
    bone_of, order_of = {}, {}
    for i in range(1, len(BONES)):
        own: list[Any] = [frames[BONES[i]]]
        while parents[own[0].link.name].link.name not in BONES:
            own.insert(0, parents[own[0].link.name])
        matrix = own[0].joint.offset.get_matrix()[0].double()
        if not bool(matrix.isfinite().all()):
            raise ValueError(f"{BONES[i]}: expected finite numbers for its place")
        rest_rotation[i], rest_offset[i] = _orthonormal(matrix[:3, :3]), matrix[:3, 3]
        for place, frame in enumerate(own):
            bone_of[frame.joint.name], order_of[frame.joint.name] = i, place
    tips = torch.stack([frames[f"{finger}_tip"].joint.offset.get_matrix()[0, :3, 3].double() for finger in FINGERS])
    if not bool(tips.isfinite().all()):
        raise ValueError("expected finite numbers for the places of the tips")
    limits = torch.tensor([joints[dof].joint.limits for dof in JOINT_DOFS], dtype=torch.float64)
    axes = torch.stack([joints[dof].joint.axis.double() for dof in JOINT_DOFS])
    if not bool(limits.isfinite().all() & axes.isfinite().all() & (limits[:, 0] <= limits[:, 1]).all()):
        raise ValueError("expected finite axes, and limits from the lower to the upper one")
    return Skeleton(
        rest_rotation=rest_rotation,
        rest_offset=rest_offset,
        tip_offset=tips,
        axis=axes,
        bone=tuple(bone_of[dof] for dof in JOINT_DOFS),
        order=tuple(order_of[dof] for dof in JOINT_DOFS),
        lower=limits[:, 0],
        upper=limits[:, 1],
    )


def _walk(frame: Any) -> Iterator[Any]:
    yield frame
    for child in frame.children:
        yield from _walk(child)


def _tip_bones() -> list[str]:
    return [f"{finger}_distal" for finger in FINGERS]


def _numbers(vector: Tensor) -> str:
    return " ".join(f"{round(float(value), _DIGITS) + 0.0:.{_DIGITS}f}" for value in vector)  # no -0.0


def _origin(offset: Tensor, rotation: Tensor) -> str:
    """URDF's origin element; rpy are rotations about the fixed x, y, z axes in turn."""
    roll = math.atan2(float(rotation[2, 1]), float(rotation[2, 2]))
    pitch = math.asin(max(-1.0, min(1.0, -float(rotation[2, 0]))))
    yaw = math.atan2(float(rotation[1, 0]), float(rotation[0, 0]))
    rpy = torch.tensor((roll, pitch, yaw), dtype=torch.float64)
    return f'\n    <origin xyz="{_numbers(offset)}" rpy="{_numbers(rpy)}"/>'


def _orthonormal(matrix: Tensor) -> Tensor:
    """The nearest rotation: the parser rounds to float32. By Newton's iteration, whose bits no processor's libraries
    change as they do those of a singular value decomposition.
    """
    for _ in range(_NEWTON_STEPS):
        matrix = 1.5 * matrix - 0.5 * ordered_product(matrix, ordered_product(matrix.mT, matrix))
    return matrix
