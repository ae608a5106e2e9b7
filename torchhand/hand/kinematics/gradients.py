"""The derivative of the chain of bones in closed form: forces on points and moments on bones, from tips to root."""

import torch
from torch import Tensor

from torchhand.geometry import cross, exponential_coefficients, turn_back
from torchhand.hand.kinematics.constants import ChainConstants
from torchhand.hand.kinematics.joint_rotations import free_axes
from torchhand.precision import own_precision


@own_precision
def chain_gradients(
    pose: Tensor,
    reference: Tensor | None,
    levers: Tensor,
    placed: tuple[Tensor, Tensor, Tensor],
    constants: ChainConstants,
    gradients: tuple[Tensor | None, ...],
    *,
    needs_reference: bool,
    needs_levers: bool,
) -> tuple[Tensor, Tensor | None, Tensor | None]:
    """Gradients of a function of the placed bones in pose, reference and levers, by virtual work.

    placed: rotations, origins and keypoints that `place_chain` gave for these; gradients: those of the function in
    them. Differentiable itself.
    """
    rotation, position, keypoints = placed
    of_rotation, of_position, of_keypoints = gradients
    points = torch.cat((position, keypoints[4:5], keypoints[8::4]))
    force = _forces(points, of_position, of_keypoints, constants)
    moment = cross(points, force)  # about the world's origin
    if of_rotation is not None:
        spin = column_spin(rotation, of_rotation)
        moment = torch.cat((moment[:20] + spin, moment[20:]))
    wrench = torch.cat((force, moment), 1)
    tips = wrench[20:]
    fourth = wrench[16:20] + tips[1:]
    third = wrench[11:16] + torch.cat((tips[:1], fourth))
    second = wrench[6:11] + third
    first = wrench[1:6] + second
    whole = wrench[0] + first.sum(0)
    borne = torch.cat((first, second, third, fourth))  # by the joint at the origin of each bone
    about = borne[:, 3:] - cross(position[1:], borne[:, :3])
    of_angles = _angle_work(turn_back(rotation[1:], about), pose, constants)
    of_root = whole[3:] - cross(position[:1], whole[None, :3])[0]
    vector = pose[3:6]
    along, second_order, third_order = exponential_coefficients((vector * vector).sum(0))
    once = cross(vector[None], of_root[None])[0]
    twice = cross(vector[None], once[None])[0]
    of_vector = of_root - second_order * once + third_order * twice
    of_pose = torch.cat((whole[:3], of_vector, of_angles))
    of_reference = None
    if reference is not None and needs_reference:
        before = of_root - along * once + second_order * twice  # expᵀ · moment
        of_reference = 0.5 * torch.stack([cross(before[None], reference[None, :, j])[0] for j in range(3)], 1)
        of_reference = _shrunk(of_reference, reference)
    of_levers = None
    if needs_levers:
        pulled = torch.cat((borne[:, :3], tips[:, :3])).index_select(0, constants.lever_ends - 1)
        of_levers = torch.cat((turn_back(rotation[:1], pulled[:5]), turn_back(rotation[1:], pulled[5:])))
        of_levers = _shrunk(of_levers, levers)
    return of_pose, of_reference, of_levers


def column_spin(rotation: Tensor, change: Tensor) -> Tensor:
    """Sum of the cross products of the columns of two matrices (bones, 3, 3, n)."""
    (x, y, z), (dx, dy, dz) = rotation.unbind(1), change.unbind(1)
    return torch.stack(((y * dz - z * dy).sum(1), (z * dx - x * dz).sum(1), (x * dy - y * dx).sum(1)), 1)


def _angle_work(moment: Tensor, pose: Tensor, constants: ChainConstants) -> Tensor:
    """Components of the moments (19, 3, n), in the bones' frames, about the axes of the thirty angles."""
    of_hinges = (constants.hinge_axis * torch.cat((moment[1:5], moment[10:]))).sum(1)
    of_free = (free_axes(pose, constants) * torch.cat((moment[:1], moment[5:10]))[:, None]).sum(2)
    return torch.cat((of_hinges, of_free.flatten(0, 1))).index_select(0, constants.angle_rows)


def _forces(
    points: Tensor, of_position: Tensor | None, of_keypoints: Tensor | None, constants: ChainConstants
) -> Tensor:
    if of_keypoints is None:
        force = torch.zeros_like(points)
    else:
        padded = torch.cat((of_keypoints, torch.zeros_like(of_keypoints[:1])))
        force = padded.index_select(0, constants.point_keypoints)
    if of_position is None:
        return force
    return torch.cat((force[:20] + of_position, force[20:]))


def _shrunk(gradient: Tensor, like: Tensor) -> Tensor:
    return gradient.sum(-1, keepdim=True) if like.shape[-1] == 1 and gradient.shape[-1] != 1 else gradient
