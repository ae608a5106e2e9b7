"""What of a robot hand may touch: capsules for the phalanges, and the links whose contacts mean nothing."""

from dataclasses import dataclass
from itertools import combinations, pairwise

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.export.clip import MotionClip
from torchhand.hand import BONES, CONE_BONES, CONE_NAMES, DOFS, FINGERS, JOINT_DOFS, PARENTS, Clearance, primitive_sizes

_PALM_GAP = 4e-3
"""Metres by which the metacarpals' meshes (MuJoCo takes their convex hulls) stand out from the palm's primitive."""


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """A phalanx as a capsule in its bone's frame: the cone of the hand's primitives with its mean radius."""

    bone: str
    start: Float64[Tensor, "3"]
    end: Float64[Tensor, "3"]
    radius: float


def phalanx_capsules(clip: MotionClip) -> tuple[Capsule, ...]:
    """One for each of the fourteen phalanges of a clip's hand."""
    sizes = primitive_sizes(clip.model.shape_space, clip.shape)
    side = torch.tensor((1.0, 1.0, 1.0 if clip.side == "right" else -1.0), dtype=torch.float64)
    start = sizes.cone_origin * side
    end = (sizes.cone_origin + sizes.cone_turn[..., 1] * sizes.cone_length[:, None]) * side
    radius = sizes.cone_start[:, 0] * 0.5 * (1 + sizes.cone_end_scale)
    return tuple(
        Capsule(bone=BONES[CONE_BONES[i]], start=start[i], end=end[i], radius=float(radius[i]))
        for i in range(1, len(CONE_NAMES))
    )


def touching_neighbours() -> list[tuple[str, str]]:
    """Bones that touch by being of one palm or side by side at its edge."""
    palm = ["wrist", *(f"{finger}_metacarpal" for finger in FINGERS)]
    proximal = [f"{finger}_proximal" for finger in FINGERS]
    pairs = [*combinations(palm, 2), *((one, other) for one in palm for other in proximal)]
    return [*pairs, *pairwise(proximal)]


def jointed_bones() -> list[tuple[str, str]]:
    """Bones that a joint connects."""
    return [(BONES[parent], bone) for bone, parent in zip(BONES, PARENTS, strict=True) if parent >= 0]


def apart(clip: MotionClip) -> Float64[Tensor, "frames 36"]:
    """The clip's poses with their joint angles changed as little as it takes for no two digits to be in each other."""
    joints = clip.poses[:, -len(JOINT_DOFS) :]
    clearance = Clearance(clip.model.kinematics("right", dtype=torch.float64), clip.shape, palm_gap=_PALM_GAP)
    return torch.cat((clip.poses[:, : len(DOFS) - len(JOINT_DOFS)], clearance.separated(joints)), -1)
