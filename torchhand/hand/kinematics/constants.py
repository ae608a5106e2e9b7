"""What the chain of bones needs to know of a skeleton, multiplied out once."""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from torchhand.geometry import rodrigues_matrix, skew
from torchhand.hand.kinematics.skeleton import BONES, JOINT_DOFS, KEYPOINTS, ROOT_DOFS, Skeleton

FREE_BONES = (1, 6, 7, 8, 9, 10)  # thumb metacarpal and all proximal phalanges: up to three angles each
HINGES = tuple(bone for bone in range(1, len(BONES)) if bone not in FREE_BONES)

# Points are the origins of the twenty bones, then five fingertips. Every bone but the wrist has exactly one point at
# its end; levers stand in the order of the bones that carry them: five of the wrist, then those of the bones 1 to 19.
LEVER_ENDS = (*range(1, 6), *range(6, 16), 20, *range(16, 20), *range(21, 25))
POINT_COUNT = 25
_KEYPOINT_POINTS = (0, 1, 6, 11, 20, 7, 12, 16, 21, 8, 13, 17, 22, 9, 14, 18, 23, 10, 15, 19, 24)


@dataclass(frozen=True, kw_only=True)
class ChainConstants:
    """Coefficients of rotations and axes in products of cosines and sines, and places in index lists."""

    free_rotation: Float[Tensor, "6 9 27"]
    """Local rotation of a free bone from the products of (1, cos, sin) of its three angles."""
    free_axes: Float[Tensor, "6 9 9"]
    """The three axes of a free bone in that bone's frame, from the products of (1, cos, sin) of its second and third
    angle."""
    hinge_rotation: Float[Tensor, "3 13 9 1"]
    """Local rotation of a hinge: constant part, part with cos, part with sin of its angle."""
    hinge_axis: Float[Tensor, "13 3 1"]
    """Axis of each hinge in the frame of the bone that it moves."""
    root_rotation: Float[Tensor, "9 12"]
    """exp(v) - I from sin|v|/|v| · v and (1 - cos|v|)/|v|² · v vᵀ."""
    identity: Float[Tensor, "9 1"]
    angles: Int[Tensor, "31"]
    """Rows of the pose: the angles of the 13 hinges, then three of each free bone; a missing angle's row is any."""
    angle_rows: Int[Tensor, "30"]
    """Row of each joint angle among the 31 of the chain."""
    keypoint_points: Int[Tensor, "21"]
    """The points that are keypoints."""
    point_keypoints: Int[Tensor, "25"]
    """Keypoint at each point; 21 where the point has none."""
    lever_ends: Int[Tensor, "24"]
    """The point at the end of every lever."""


def chain_constants(skeleton: Skeleton) -> ChainConstants:
    """The constants of a skeleton from exp(θ a) = (1) aaᵀ + (cos θ) (I - aaᵀ) + (sin θ) [a]."""
    like = skeleton.axis
    rotations, axes, slots = {}, {}, {}
    for bone in range(1, len(BONES)):
        own = sorted((i for i in range(len(JOINT_DOFS)) if skeleton.bone[i] == bone), key=lambda i: skeleton.order[i])
        allowed = 1 if bone in HINGES else 3
        if not 1 <= len(own) <= allowed:
            raise ValueError(f"bone {BONES[bone]}: expected 1 to {allowed} angles, got {len(own)}")
        missing = 3 - len(own)
        unit = [skeleton.axis[i] / skeleton.axis[i].norm() for i in own] + [torch.zeros_like(like[0])] * missing
        factors = [_factors(axis) for axis in unit]
        product = torch.einsum("ab,ibc,jcd,kde->aeijk", skeleton.rest_rotation[bone], *factors)
        rotations[bone] = product.reshape(9, 3, 3, 3)
        axes[bone] = _axes_in_bone(unit, factors)
        slots[bone] = own + own[:1] * missing
    hinge = torch.stack([rotations[bone][..., 0, 0] for bone in HINGES])
    places = [slots[bone][0] for bone in HINGES] + [slot for bone in FREE_BONES for slot in slots[bone]]

    def index(values: list[int] | tuple[int, ...]) -> Tensor:
        return torch.tensor(values, device=like.device)

    first = len(ROOT_DOFS)
    keypoints = [_KEYPOINT_POINTS.index(p) if p in _KEYPOINT_POINTS else len(KEYPOINTS) for p in range(POINT_COUNT)]
    return ChainConstants(
        free_rotation=torch.stack([rotations[bone].reshape(9, 27) for bone in FREE_BONES]),
        free_axes=torch.stack([axes[bone] for bone in FREE_BONES]),
        hinge_rotation=hinge.movedim(-1, 0)[..., None].contiguous(),
        hinge_axis=torch.stack([axes[bone][:3, :1] for bone in HINGES]),
        root_rotation=rodrigues_matrix(like),
        identity=torch.eye(3, dtype=like.dtype, device=like.device).reshape(9, 1),
        angles=index([first + slot for slot in places]),
        angle_rows=index([places.index(slot) for slot in range(len(JOINT_DOFS))]),
        keypoint_points=index(_KEYPOINT_POINTS),
        point_keypoints=index(keypoints),
        lever_ends=index(LEVER_ENDS),
    )


def _factors(axis: Tensor) -> Tensor:
    """The three matrices of exp(θ axis) that go with 1, cos θ and sin θ; I, 0, 0 for a missing axis (zero)."""
    identity = torch.eye(3, dtype=axis.dtype, device=axis.device)
    if not bool(axis.any()):
        return torch.stack((identity, 0 * identity, 0 * identity))
    outer = axis[:, None] * axis[None, :]
    return torch.stack((outer, identity - outer, skew(axis)))


def _axes_in_bone(unit: list[Tensor], factors: list[Tensor]) -> Tensor:
    """(9, 9): an axis is turned back by the angles that are applied after it."""
    second, third = (f.transpose(-1, -2) for f in factors[1:])
    table = torch.zeros(3, 3, 3, 3, dtype=unit[0].dtype, device=unit[0].device)  # angle, component, second, third
    table[0] = torch.einsum("kab,jbc,c->ajk", third, second, unit[0])
    table[1, :, 0] = torch.einsum("kab,b->ak", third, unit[1])
    table[2, :, 0, 0] = unit[2]
    return table.reshape(9, 9)


class ChainBuffers(nn.Module):
    """The constants as buffers, so that they move with the module that holds them."""

    def __init__(self, constants: ChainConstants) -> None:
        super().__init__()
        for name in ChainConstants.__dataclass_fields__:
            self.register_buffer(name, getattr(constants, name), persistent=False)
        self._constants = constants

    def _apply(self, *args: Any, **kwargs: Any) -> "ChainBuffers":
        super()._apply(*args, **kwargs)
        self._constants = ChainConstants(**{name: getattr(self, name) for name in ChainConstants.__dataclass_fields__})
        return self

    @property
    def constants(self) -> ChainConstants:
        return self._constants
