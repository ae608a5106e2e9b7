"""The chain of bones in plain operations: for compilers and exporters, which take no hand-written derivative."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import exponential_coefficients
from torchhand.geometry.batch_last import compose, turn
from torchhand.hand.chain_constants import ChainConstants
from torchhand.hand.joint_rotations import local_rotations


def place_chain_plainly(
    pose: Float[Tensor, "36 n"],
    reference: Float[Tensor, "3 3 #n"] | None,
    levers: Float[Tensor, "24 3 #n"],
    constants: ChainConstants,
) -> tuple[Float[Tensor, "20 3 3 n"], Float[Tensor, "20 3 n"], Float[Tensor, "21 3 n"]]:
    """As `place_chain`, and what that must equal."""
    root = _exponential(pose[3:6], constants)
    root = root[None] if reference is None else compose(root[None], reference[None])
    local = local_rotations(pose, constants)
    first = compose(root, local[:5])
    second = compose(first, local[5:10])
    third = compose(second, local[10:15])
    fourth = compose(third[1:], local[15:])
    origin = pose[None, :3]
    ends = origin + turn(root, levers[:5])
    second_ends = ends + turn(first, levers[5:10])
    third_ends = second_ends + turn(second, levers[10:15])
    thumb_tip = third_ends[:1] + turn(third[:1], levers[15:16])
    fourth_ends = third_ends[1:] + turn(third[1:], levers[16:20])
    tips = fourth_ends + turn(fourth, levers[20:])
    rotation = torch.cat((root, first, second, third, fourth))
    position = torch.cat((origin, ends, second_ends, third_ends, fourth_ends))
    points = torch.cat((position, thumb_tip, tips))
    return rotation, position, points.index_select(0, constants.keypoint_points)


def _exponential(vector: Tensor, constants: ChainConstants) -> Tensor:
    first, second, _ = exponential_coefficients((vector * vector).sum(0))
    products = (second * vector)[:, None] * vector[None]
    basis = torch.cat((first * vector, products.flatten(0, 1)))
    return torch.addmm(constants.identity, constants.root_rotation, basis).unflatten(0, (3, 3))
