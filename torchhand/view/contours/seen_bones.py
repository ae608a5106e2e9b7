"""Bones of some hands in a camera's frame and how each DOF moves them, in few operations.

`HandKinematics` is made for thousands of poses and for gradients. Registration places a few hands many times, where
what counts is how many operations there are: here a bone's whole motion relative to its parent is one product of a
table, and a level of the tree is one product of matrices.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import BONES, ROOT_DOFS, HandKinematics
from torchhand.hand.kinematics import FREE_BONES, HINGES, LEVER_ENDS

_ROOT = len(ROOT_DOFS)
_LEVELS = ((0, 1, 0, 5), (0, 5, 5, 10), (0, 5, 10, 15), (1, 5, 15, 19))
"""First and last-but-one of the parents among the level before, and of the bones among all but the wrist."""
_LEVER_OF_BONE = [LEVER_ENDS.index(bone) for bone in range(1, len(BONES))]


@dataclass(frozen=True, kw_only=True)
class SeenBones:
    """Hands before a camera, in its frame."""

    cam_from_bone: Float[Tensor, "hands 20 3 4"]
    """Rotation and, last, origin in metres."""
    screws: Float[Tensor, "hands 36 6"]
    """Screw by which each DOF moves all that it carries: turn, and shift of the camera's centre, per radian or
    metre."""


class BonePlacer:
    """Poses to `SeenBones`, for one kinematics, shape and camera; what does not change is laid out once."""

    def __init__(
        self, kinematics: HandKinematics, camera: Camera, shape: Float[Tensor, "shape"], dtype: torch.dtype
    ) -> None:
        constants = kinematics.chain.constants
        like = constants.hinge_axis.to(dtype)
        rotation, translation = camera.rotation.to(like), camera.translation.to(like)
        self._rotation = rotation
        # Translation and rotation vector of the root are turned into the camera's frame.
        self._root_turn = torch.block_diag(rotation, rotation).T
        self._root_shift = torch.cat((translation, like.new_zeros(3)))
        self._of_vector, self._identity = constants.root_rotation.T.to(like), constants.identity.T.to(like)
        # Which of the factors of v and of v vᵀ, in a row, go with the exponential and with the left Jacobian.
        factors = ((0, 3), (1, 9)), ((1, 3), (2, 9))
        places = [place for terms in factors for which, times in terms for place in [which] * times]
        self._factors = torch.tensor(places, device=like.device)
        self._angles = _angles(constants.angles)
        levers = (kinematics.lever_matrix.to(like) @ kinematics.metres(shape).to(like)).unflatten(0, (-1, 3))
        self._locals = _local_table(constants.hinge_rotation.to(like), constants.free_rotation.to(like), levers)
        axes = like.new_zeros(len(BONES) - 1, 9, 9)
        for row, bone in enumerate(HINGES):
            axes[bone - 1, 0, :3] = constants.hinge_axis[row, :, 0]
        axes[[bone - 1 for bone in FREE_BONES]] = constants.free_axes.mT.to(like)
        self._axes = axes
        slots = [3 * (bone - 1) for bone in HINGES] + [3 * (bone - 1) + i for bone in FREE_BONES for i in range(3)]
        self._slots = torch.tensor(slots, device=like.device)[constants.angle_rows]
        bones = torch.tensor(kinematics.skeleton.bone, device=like.device)
        self._centres = torch.cat((bones.new_zeros(3), bones))  # the root turns about its place
        self._moves = torch.cat((torch.zeros_like(rotation), rotation.T), 1)

    def __call__(self, pose: Float[Tensor, "hands 36"], root_reference: Float[Tensor, "hands 3 3"]) -> SeenBones:
        """Bones of poses with rotation vectors about their references: world_from_hand = exp(vector) · reference."""
        hands = len(pose)
        place, vector = torch.addmm(self._root_shift, pose[:, :_ROOT], self._root_turn).split(3, 1)
        turn, jacobian = self._exponential(vector)
        root = torch.cat((turn @ (self._rotation @ root_reference), place[..., None]), 2)
        # (1, cos, sin) of the three angles of every bone, multiplied out; the bones first.
        angles = pose.T.index_select(0, self._angles).unflatten(0, (-1, 3))
        first, second, third = torch.stack((torch.ones_like(angles), angles.cos(), angles.sin()), 2).unbind(1)
        outer = (second[:, :, None] * third[:, None]).flatten(1, 2).mT
        local = torch.bmm((first.mT[..., None] * outer[:, :, None]).flatten(2), self._locals)
        local = local.unflatten(2, (4, 4)).transpose(0, 1)
        levels = [root[:, None]]
        for first_parent, last_parent, start, stop in _LEVELS:
            levels.append(levels[-1][:, first_parent:last_parent] @ local[:, start:stop])
        cam_from_bone = torch.cat(levels, 1)
        own = torch.bmm(outer, self._axes).transpose(0, 1).unflatten(2, (3, 3))  # rows: axes in the bone's frame
        axes = (own @ cam_from_bone[:, 1:, :, :3].mT).flatten(1, 2).index_select(1, self._slots)
        turns = torch.cat(((jacobian @ self._rotation).mT, axes), 1)
        centres = cam_from_bone[..., 3].index_select(1, self._centres)
        screws = torch.cat((turns, torch.linalg.cross(centres, turns)), 2)
        return SeenBones(
            cam_from_bone=cam_from_bone,
            screws=torch.cat((self._moves.expand(hands, 3, 6), screws), 1),
        )

    def _exponential(
        self, vector: Float[Tensor, "hands 3"]
    ) -> tuple[Float[Tensor, "hands 3 3"], Float[Tensor, "hands 3 3"]]:
        """exp(v) = I + f₁ [v] + f₂ [v]² and its left Jacobian I + f₂ [v] + f₃ [v]², with f₁ = sin a / a,
        f₂ = (1 - cos a) / a², f₃ = (1 - f₁) / a² for a = |v|. What f₃ loses near 0, v² makes good."""
        squared = (vector * vector).sum(1, keepdim=True)
        turns = squared.sqrt() / torch.pi
        first, half = torch.sinc(turns), torch.sinc(0.5 * turns)
        third = (1 - first) / squared.clamp_min(torch.finfo(vector.dtype).tiny)
        factors = torch.cat((first, 0.5 * half * half, third), 1).index_select(1, self._factors)
        powers = torch.cat((vector, (vector[:, :, None] * vector[:, None]).flatten(1)), 1)
        both = (factors.unflatten(1, (2, -1)) * powers[:, None]) @ self._of_vector + self._identity
        turn, jacobian = both.unflatten(2, (3, 3)).unbind(1)
        return turn, jacobian


def _angles(of_chain: Tensor) -> Tensor:
    """Rows of the pose: three angles of every bone but the wrist, repeated where it has one."""
    rows = {bone: [row] * 3 for bone, row in zip(HINGES, of_chain[: len(HINGES)].tolist(), strict=True)}
    free = of_chain[len(HINGES) :].reshape(-1, 3).tolist()
    rows |= dict(zip(FREE_BONES, free, strict=True))
    return torch.tensor([rows[bone] for bone in range(1, len(BONES))], device=of_chain.device).flatten()


def _local_table(
    hinges: Float[Tensor, "3 13 9 1"], free: Float[Tensor, "6 9 27"], levers: Float[Tensor, "24 3"]
) -> Float[Tensor, "19 27 16"]:
    """parent_from_bone, 4 × 4, from the products of (1, cos, sin) of a bone's three angles; the first is 1."""
    table = free.new_zeros(len(BONES) - 1, 27, 4, 4)
    for row, bone in enumerate(HINGES):
        table[bone - 1, (0, 9, 18), :3, :3] = hinges[:, row, :, 0].unflatten(1, (3, 3))
    table[[bone - 1 for bone in FREE_BONES], :, :3, :3] = free.mT.unflatten(2, (3, 3))
    table[:, 0, :3, 3] = levers[_LEVER_OF_BONE]
    table[:, 0, 3, 3] = 1.0
    return table.flatten(2)
