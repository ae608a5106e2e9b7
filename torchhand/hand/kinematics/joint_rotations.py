"""Rotations of the bones in their parents' frames, and the axes of the joint angles; the batch stands last."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import turn
from torchhand.hand.kinematics.constants import HINGES, ChainConstants

_HINGES = len(HINGES)  # hinges are the bones 2 to 5 and 11 to 19, free bones 1 and 6 to 10


def local_rotations(pose: Float[Tensor, "36 n"], constants: ChainConstants) -> Float[Tensor, "19 3 3 n"]:
    """parent_from_bone of every bone but the root."""
    angles = pose.index_select(0, constants.angles)
    cosine, sine = angles.cos(), angles.sin()
    constant, of_cosine, of_sine = constants.hinge_rotation.unbind()
    hinge = torch.addcmul(constant, of_cosine, cosine[:_HINGES, None])
    hinge = torch.addcmul(hinge, of_sine, sine[:_HINGES, None])
    first, second, third = _free_basis(cosine, sine).unbind(1)
    products = _products(_products(first, second), third)
    free = torch.bmm(constants.free_rotation, products)
    return torch.cat((free[:1], hinge[:4], free[1:], hinge[4:])).unflatten(1, (3, 3))


def free_axes(pose: Float[Tensor, "36 n"], constants: ChainConstants) -> Float[Tensor, "6 3 3 n"]:
    """Axes of the three angles of every free bone, in that bone's frame."""
    angles = pose.index_select(0, constants.angles)
    basis = _free_basis(angles.cos(), angles.sin())
    return torch.bmm(constants.free_axes, _products(basis[:, 1], basis[:, 2])).unflatten(1, (3, 3))


def world_axes(
    pose: Float[Tensor, "36 n"], rotation: Float[Tensor, "20 3 3 n"], constants: ChainConstants
) -> Float[Tensor, "30 3 n"]:
    """Axis of every joint angle in the world, from the bones' rotations there."""
    hinges, free = torch.cat((rotation[2:6], rotation[11:])), torch.cat((rotation[1:2], rotation[6:11]))
    of_free = [turn(free, axis) for axis in free_axes(pose, constants).unbind(1)]
    both = torch.cat((turn(hinges, constants.hinge_axis), torch.stack(of_free, 1).flatten(0, 1)))
    return both.index_select(0, constants.angle_rows)


def _free_basis(cosine: Tensor, sine: Tensor) -> Tensor:
    """(1, cos, sin) of the three angles of the free bones: (6, 3, 3, n)."""
    cosine, sine = cosine[_HINGES:], sine[_HINGES:]
    return torch.stack((torch.ones_like(cosine), cosine, sine), 1).unflatten(0, (-1, 3))


def _products(left: Tensor, right: Tensor) -> Tensor:
    return (left[:, :, None] * right[:, None]).flatten(1, 2)
