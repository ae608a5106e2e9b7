"""MANO's sixteen axis-angle rotations and our angles. Only its joint order and axes are used: no file of MANO's.

At zero all frames of MANO's skeleton are parallel: fingers along -x of the right hand (+x of the left one), the back of
the hand to +y, the thumb's side to +z. A joint's rotation is its turn relative to its parent since
then. Its fingers have no metacarpals: what bends in our palm is part of the rotation at the knuckle, and only the
direction of the finger survives, not the knuckle's place.

MANO's zero posture is taken for ours, all angles zero, unless `rest` says which of our postures looks like it.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand.conventions.bone_fit import BoneFit, fit_bones
from torchhand.hand.conventions.bone_turns import turns_in_world
from torchhand.hand.kinematics import BONES, DOFS, ROOT_DOFS, HandKinematics, Side
from torchhand.precision import own_precision

MANO_JOINTS = (
    "wrist",
    *(f"{finger}{i}" for finger in ("index", "middle", "little", "ring", "thumb") for i in (1, 2, 3)),
)
"""Wrist, then three joints each of index, middle, little, ring and thumb, from base to tip."""

MANO_PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)

_LEVELS = {"thumb": ("metacarpal", "proximal", "distal")}
MANO_BONES = (
    0,
    *(
        BONES.index(f"{finger}_{level}")
        for finger in ("index", "middle", "little", "ring", "thumb")
        for level in _LEVELS.get(finger, ("proximal", "middle", "distal"))
    ),
)
"""Our bone that each joint of MANO moves, index into BONES."""


@dataclass(frozen=True, kw_only=True)
class ManoPose:
    """A pose as MANO has it, and what it leaves out."""

    axis_angle: Float[Tensor, "*batch 16 3"]
    """Rotation vector of each joint relative to its parent, radians; the first is the hand's in the world."""
    wrist: Float[Tensor, "*batch 3"]
    """Position of our wrist, metres; smplx's `transl` is this less MANO's wrist joint at rest, which its shape
    moves."""
    residual: Float[Tensor, "*batch 21"]
    """Metres by which each of our keypoints is off when MANO's rotations alone pose the hand (the palm rigid)."""


def mano_from_hand(side: Side) -> Float[Tensor, "3 3"]:
    """Axes of MANO's rest frame from those of our hand frame (x back of the hand, y fingers), float64."""
    fingers, across = (-1.0, 1.0) if side == "right" else (1.0, -1.0)
    rows = ((0.0, fingers, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, across))
    return torch.tensor(rows, dtype=torch.float64)


@own_precision
def mano_of_pose(
    kinematics: HandKinematics,
    pose: Float[Tensor, "*batch 36"],
    shape: Float[Tensor, "*#batch shape"] | None = None,
    *,
    rest: Float[Tensor, "36"] | None = None,
) -> ManoPose:
    """MANO's rotations of our pose. The shape is only used for the residual."""
    axes = mano_from_hand(kinematics.side).to(pose)
    frames = kinematics(pose, shape)
    since = turns_in_world(frames.rotation, rest_rotations(kinematics, rest))[..., list(MANO_BONES), :, :]
    relative = axes @ since[..., list(MANO_PARENTS[1:]), :, :].mT @ since[..., 1:, :, :] @ axes.T
    local = torch.cat((since[..., :1, :, :] @ axes.T, relative), -3)
    rigid = fit_bones(kinematics, _with_rigid_palm(kinematics, frames.rotation, rest), frames.position[..., 0, :])
    off = kinematics(rigid.pose, shape).keypoints - frames.keypoints
    return ManoPose(axis_angle=vector_from_rotation(local), wrist=pose[..., :3], residual=off.norm(dim=-1))


@own_precision
def pose_of_mano(
    kinematics: HandKinematics,
    axis_angle: Float[Tensor, "*batch 16 3"],
    wrist: Float[Tensor, "*batch 3"],
    *,
    rest: Float[Tensor, "36"] | None = None,
) -> BoneFit:
    """Our pose of MANO's rotations; the residual is what our joints cannot do (a knuckle of three angles can do all).

    The palm stays as at rest.
    """
    axes = mano_from_hand(kinematics.side).to(axis_angle)
    local = rotation_from_vector(axis_angle)
    turns = [local[..., 0, :, :] @ axes]
    for joint in range(1, len(MANO_JOINTS)):
        turns.append(turns[MANO_PARENTS[joint]] @ axes.T @ local[..., joint, :, :] @ axes)
    since = turns[0][..., None, :, :].expand(*turns[0].shape[:-2], len(BONES), 3, 3).clone()
    for joint, bone in enumerate(MANO_BONES):
        since[..., bone, :, :] = turns[joint]
    return fit_bones(kinematics, since @ rest_rotations(kinematics, rest), wrist)


def rest_rotations(kinematics: HandKinematics, rest: Float[Tensor, "36"] | None = None) -> Float[Tensor, "20 3 3"]:
    """hand_from_bone at a posture (all angles zero where it is None); its root is disregarded."""
    like = kinematics.default_shape
    posture = torch.zeros(len(DOFS)).to(like) if rest is None else rest.to(like).clone()
    posture[: len(ROOT_DOFS)] = 0
    return kinematics(posture).rotation


def _with_rigid_palm(kinematics: HandKinematics, rotation: Tensor, rest: Tensor | None) -> Tensor:
    """The same bones with the fingers' metacarpals as they are at rest."""
    palm = [BONES.index(f"{finger}_metacarpal") for finger in ("index", "middle", "ring", "little")]
    changed = rotation.clone()
    changed[..., palm, :, :] = rotation[..., :1, :, :] @ rest_rotations(kinematics, rest)[palm].to(rotation)
    return changed
