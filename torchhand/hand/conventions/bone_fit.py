"""Joint angles whose bones are turned as given: the way back from any skeleton's rotations to a pose."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand.kinematics import BONES, JOINT_DOFS, PARENTS, HandKinematics, Skeleton, sided_skeleton
from torchhand.precision import own_precision

_STEPS = 20
_DAMPING = 1e-10
_ENOUGH = 1e-12  # radians


@dataclass(frozen=True, kw_only=True)
class BoneFit:
    """A pose found from rotations of bones."""

    pose: Float[Tensor, "*batch 36"]
    """Pose in the order of DOFS; the angles are not held to their limits (`Skeleton.within_limits` does that)."""
    residual: Float[Tensor, "*batch 20"]
    """Angle, radians, between each bone's rotation relative to its parent as given and as the pose has it."""


@own_precision
def fit_bones(
    kinematics: HandKinematics, rotation: Float[Tensor, "*batch 20 3 3"], wrist: Float[Tensor, "*batch 3"]
) -> BoneFit:
    """The pose whose joints come nearest to world_from_bone `rotation`, joint by joint.

    A joint with three angles is met exactly (unless its axes are skew and the rotation is out of reach), with two or
    one as near as it goes: the angle of the remaining rotation is least. Of several solutions the one with an abduction
    below a quarter turn is taken. wrist: origin of the hand in the world, metres. Computed in float64.
    """
    skeleton = sided_skeleton(kinematics.skeleton.to(dtype=torch.float64), kinematics.side)
    given = rotation.double()
    relative = given[..., list(PARENTS[1:]), :, :].mT @ given[..., 1:, :, :]
    joint = skeleton.rest_rotation[1:].mT @ relative
    axes, is_used = _axes_of_bones(skeleton)
    angles = _start(joint, axes, is_used)
    for _ in range(_STEPS):
        turned, columns = _turn(axes, angles)
        residual = vector_from_rotation(joint @ turned.mT)
        columns = columns * is_used[:, None, :]
        normal = columns.mT @ columns + torch.diag_embed((~is_used).double() + _DAMPING)
        step = torch.linalg.solve(normal, (columns.mT @ residual[..., None]).squeeze(-1))
        angles = angles + step
        if not step.numel() or float(step.abs().max()) < _ENOUGH:
            break
    residual = vector_from_rotation(joint @ _turn(axes, angles)[0].mT).norm(dim=-1)
    angles = torch.remainder(angles + torch.pi, 2 * torch.pi) - torch.pi
    root = vector_from_rotation(given[..., 0, :, :])
    ordered = [angles[..., skeleton.bone[i] - 1, _slot(i)] for i in range(len(JOINT_DOFS))]
    pose = torch.cat((wrist.double(), root, torch.stack(ordered, -1)), -1)
    return BoneFit(
        pose=pose.to(rotation.dtype),
        residual=torch.cat((torch.zeros_like(residual[..., :1]), residual), -1).to(rotation.dtype),
    )


def _slot(dof: int) -> int:
    """Place of an angle among the three of its bone: abduction 0, flexion 1, twist 2; a hinge has flexion only."""
    return {"aa": 0, "fe": 1, "tw": 2}[JOINT_DOFS[dof].rsplit("_", 1)[1]]


def _axes_of_bones(skeleton: Skeleton) -> tuple[Float[Tensor, "19 3 3"], Bool[Tensor, "19 3"]]:
    """Unit axis of every slot (rows) of every bone, zero where it has none; and which it has."""
    axes = torch.zeros(len(BONES) - 1, 3, 3, dtype=torch.float64)
    is_used = torch.zeros(len(BONES) - 1, 3, dtype=torch.bool)
    for dof, bone in enumerate(skeleton.bone):
        slot = _slot(dof)
        axis = skeleton.axis[dof]
        axes[bone - 1, slot], is_used[bone - 1, slot] = axis / axis.norm(), True
    return axes, is_used


def _turn(
    axes: Float[Tensor, "19 3 3"], angles: Float[Tensor, "*batch 19 3"]
) -> tuple[Float[Tensor, "*batch 19 3 3"], Float[Tensor, "*batch 19 3 3"]]:
    """Rotation of the angles, and their axes as they stand in it (columns)."""
    parts = rotation_from_vector(angles[..., None] * axes)
    first, second, third = parts.unbind(-3)
    both = first @ second
    columns = [
        axes[:, 0].expand(*angles.shape[:-1], 3),
        (first @ axes[:, 1, :, None]).squeeze(-1),
        (both @ axes[:, 2, :, None]).squeeze(-1),
    ]
    return both @ third, torch.stack(columns, -1)


def _start(joint: Tensor, axes: Tensor, is_used: Tensor) -> Tensor:
    """Angles as if the axes were orthogonal: abduction, flexion and twist of a rotation about x, z and y in turn."""
    flexion = axes[:, 1]
    outer = torch.where(is_used[:, :1], axes[:, 0], _any_across(flexion))
    outer = torch.nn.functional.normalize(outer - (outer * flexion).sum(-1, keepdim=True) * flexion, dim=-1)
    inner = torch.linalg.cross(flexion, outer)
    basis = torch.stack((outer, inner, flexion), -1)
    turn = basis.mT @ joint @ basis
    sine, rest = -turn[..., 0, 1], torch.hypot(turn[..., 0, 0], turn[..., 0, 2])
    bend, aside = torch.atan2(sine, rest), torch.atan2(turn[..., 2, 1], turn[..., 1, 1])
    twist = torch.atan2(turn[..., 0, 2], turn[..., 0, 0])
    is_far = aside.abs() > 0.5 * torch.pi
    half = torch.full_like(bend, torch.pi)
    bend = torch.where(is_far, torch.copysign(half, bend) - bend, bend)
    aside = torch.where(is_far, aside - torch.copysign(half, aside), aside)
    twist = torch.where(is_far, twist - torch.copysign(half, twist), twist)
    # At a right angle of flexion abduction and twist turn about one line: all of it is left to the step that follows.
    is_degenerate = rest < 1e-9
    aside, twist = (torch.where(is_degenerate, torch.zeros_like(x), x) for x in (aside, twist))
    hinge = torch.atan2(turn[..., 1, 0] - turn[..., 0, 1], turn[..., 0, 0] + turn[..., 1, 1])  # nearest turn about z
    bend = torch.where(is_used[:, 0], bend, hinge)
    twist = twist * torch.where((inner * axes[:, 2]).sum(-1) < 0, -1.0, 1.0)
    return torch.stack((aside, bend, twist), -1) * is_used


def _any_across(axis: Float[Tensor, "19 3"]) -> Float[Tensor, "19 3"]:
    """Some direction that is not parallel to each axis."""
    minimum = axis.abs().argmin(-1)
    return torch.nn.functional.one_hot(minimum, 3).to(axis)
