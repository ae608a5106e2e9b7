"""Derivative of points of the skin in the pose, in closed form.

An angle turns the parts of a skinned point that the bones beyond its joint carry: with weights w_b and parts s_b of
the point, the derivative is axis × Σ_b (s_b − w_b · origin of the joint), plus what the angle's own corrective changes.
The root's rotation vector turns the whole point about the columns of its left Jacobian.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.geometry import batch_first, batch_last, common_shape, left_jacobian
from torchhand.hand.hand import Hand
from torchhand.hand.kinematics import DOFS, ROOT_DOFS, world_axes
from torchhand.precision import own_precision


@own_precision
def skin_jacobian(
    hand: Hand,
    pose: Float[Tensor, "*#batch 36"],
    vertices: Int[Tensor, "*#batch points corners"],
    weights: Float[Tensor, "*#batch points corners"] | None = None,
    *,
    shape: Float[Tensor, "*#batch shape"] | None = None,
    root_reference: Float[Tensor, "*#batch 3 3"] | None = None,
) -> tuple[Float[Tensor, "*batch points 3"], Float[Tensor, "*batch points 3 36"]]:
    """Points of the skin in the world, metres, and their derivative in the pose (per metre, per radian).

    vertices: indices of each point's corners: (points, 1) for vertices, (points, 3) for points on triangles; with
        leading dimensions where the points differ from hand to hand.
    weights: barycentric weights of the corners; equal ones where it is None.
    pose, shape, root_reference: as in `Hand.forward`; the rotation vector is the left perturbation of the reference.
    """
    if weights is None:
        weights = torch.full_like(vertices, 1 / vertices.shape[-1], dtype=pose.dtype)
    hand.check_sizes(pose, shape)
    shape = hand.shape if shape is None else shape
    rotations = () if root_reference is None else (root_reference[..., 0, 0],)
    batch = common_shape(pose[..., 0], shape[..., 0], vertices[..., 0, 0], weights[..., 0, 0], *rotations)
    pose = pose.expand(*batch, len(DOFS))
    frames = hand.kinematics(pose, shape, root_reference=root_reference)
    rotation, position = batch_last(frames.rotation, 3, batch), batch_last(frames.position, 2, batch)
    flat_pose, metres = batch_last(pose, 1, batch), batch_last(hand.kinematics.metres(shape), 1, batch)

    corners = batch_last(vertices, 2, batch)
    fractions = batch_last(weights.expand(common_shape(weights, vertices)), 2, batch)
    loads = hand.skinning.loads_at(corners.flatten(0, 1), metres)
    places, bone_fractions, offsets = ((x.unflatten(-2, corners.shape[:2]) * fractions).sum(-2) for x in loads)

    # Parts of the point that each bone carries, correctives included: (20, 3, points, n).
    parts = _turned(rotation, places) + bone_fractions[:, None] * position[:, :, None]
    features, slopes = hand.skinning.corrective_features(flat_pose, metres)
    bone_rotation = rotation.index_select(0, hand.skinning.corrective_bones)
    parts = parts.index_add(0, hand.skinning.corrective_bones, _corrective(bone_rotation, features, offsets))
    beyond, fraction_beyond = _beyond(parts), _beyond(bone_fractions.expand(*bone_fractions.shape[:2], parts.shape[-1]))
    points, fraction = beyond[0], fraction_beyond[0]

    bones = constant_tensor(hand.kinematics.skeleton.bone, torch.long, pose.device)
    levers = beyond - fraction_beyond[:, None] * position[:, :, None]
    axes = world_axes(flat_pose, rotation, hand.kinematics.chain.constants)
    of_angles = torch.linalg.cross(axes[:, :, None], levers.index_select(0, bones), dim=1)
    own = hand.skinning.corrective_rows - len(ROOT_DOFS)
    of_angles = of_angles.index_add(0, own, _corrective(bone_rotation, slopes, offsets))
    spin = left_jacobian(flat_pose[3:6].T).permute(2, 1, 0)  # columns first: 3 3 n
    of_vector = torch.linalg.cross(spin[:, :, None], levers[:1], dim=1)
    identity = torch.eye(3, dtype=pose.dtype, device=pose.device)
    of_shift = identity[:, :, None, None] * fraction
    jacobian = torch.cat((of_shift, of_vector, of_angles))
    return batch_first(points.transpose(0, 1), batch), batch_first(jacobian.permute(2, 1, 0, 3), batch)


def _turned(rotation: Tensor, vectors: Tensor) -> Tensor:
    """Matrices (k, 3, 3, n) times vectors (k, 3, points, #n)."""
    columns, rows = rotation[:, :, :, None].unbind(2), vectors[:, :, None].unbind(1)
    return columns[0] * rows[0] + columns[1] * rows[1] + columns[2] * rows[2]


def _corrective(bone_rotation: Tensor, factors: Tensor, offsets: Tensor) -> Tensor:
    """Sum over the two features of an angle's offsets times `factors` (c, 2, n), turned into the world."""
    return _turned(bone_rotation, (offsets * factors[:, :, None, None]).sum(1))


def _beyond(parts: Tensor) -> Tensor:
    """Sums over every bone and those that it carries, from the tips to the root; the bones stand first."""
    fourth = parts[16:]
    third = parts[11:16] + torch.cat((torch.zeros_like(parts[:1]), fourth))
    second = parts[6:11] + third
    first = parts[1:6] + second
    return torch.cat((parts[:1] + first.sum(0, keepdim=True), first, second, third, fourth))
