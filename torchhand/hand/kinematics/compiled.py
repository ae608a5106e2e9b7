"""The chain of bones in plain operations, for compilers and exporters.

They fuse what `chain` writes in place by hand; the derivative in closed form is faster there, too, than theirs.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import compose, exponential_coefficients, turn
from torchhand.hand.kinematics.constants import ChainConstants
from torchhand.hand.kinematics.gradients import chain_gradients
from torchhand.hand.kinematics.joint_rotations import local_rotations


def place_chain_compiled(
    pose: Float[Tensor, "36 n"],
    reference: Float[Tensor, "3 3 #n"] | None,
    levers: Float[Tensor, "24 3 #n"],
    constants: ChainConstants,
) -> tuple[Float[Tensor, "20 3 3 n"], Float[Tensor, "20 3 n"], Float[Tensor, "21 3 n"]]:
    """As `place_chain`, where torch compiles or exports."""
    if torch.compiler.is_exporting() or torch._C._are_functorch_transforms_active():
        return place_chain_plainly(pose, reference, levers, constants)
    return _CompiledChain.apply(pose, reference, levers, constants)


class _CompiledChain(torch.autograd.Function):
    """No vmap and no forward mode: compilers take none."""

    @staticmethod
    def forward(
        ctx: Any, pose: Tensor, reference: Tensor | None, levers: Tensor, constants: ChainConstants
    ) -> tuple[Tensor, Tensor, Tensor]:
        placed = place_chain_plainly(pose, reference, levers, constants)
        ctx.save_for_backward(pose, reference, levers, *placed)
        ctx.constants = constants
        return placed

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, Tensor | None, Tensor | None, None]:
        pose, reference, levers, *placed = ctx.saved_tensors
        needs = ctx.needs_input_grad
        found = chain_gradients(
            pose,
            reference,
            levers,
            tuple(placed),
            ctx.constants,
            gradients,
            needs_reference=needs[1],
            needs_levers=needs[2],
        )
        return *found, None


def place_chain_plainly(
    pose: Float[Tensor, "36 n"],
    reference: Float[Tensor, "3 3 #n"] | None,
    levers: Float[Tensor, "24 3 #n"],
    constants: ChainConstants,
) -> tuple[Float[Tensor, "20 3 3 n"], Float[Tensor, "20 3 n"], Float[Tensor, "21 3 n"]]:
    """As `place_chain`, and what that must equal; torch differentiates it as it is."""
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
    of_thumb = (ends[:1], second_ends[:1], third_ends[:1], thumb_tip)
    of_fingers = torch.stack((second_ends[1:], third_ends[1:], fourth_ends, tips), 1).flatten(0, 1)
    return rotation, position, torch.cat((origin, *of_thumb, of_fingers))


def _exponential(vector: Tensor, constants: ChainConstants) -> Tensor:
    first, second, _ = exponential_coefficients((vector * vector).sum(0))
    products = (second * vector)[:, None] * vector[None]
    basis = torch.cat((first * vector, products.flatten(0, 1)))
    return torch.addmm(constants.identity, constants.root_rotation, basis).unflatten(0, (3, 3))
