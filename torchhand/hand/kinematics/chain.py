"""The chain of bones as one differentiable step with a closed-form derivative.

Rotations are composed level by level over the five digits, with the batch as the last, contiguous axis. The derivative
is the geometric one: an angle feels the moment, about its axis, of everything further out, so nothing but the result
has to be kept. Reverse mode of any order, forward mode and vmap are supported; forward mode of forward mode is left to
the plain operations. The specification is a plain loop, in the tests.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch._C._functorch import TransformType, get_interpreter_stack

from torchhand.devices import is_without_derivatives
from torchhand.geometry import compose, cross, exponential_coefficients, turn
from torchhand.hand.kinematics.compiled import place_chain_compiled, place_chain_plainly
from torchhand.hand.kinematics.constants import HINGES, ChainConstants
from torchhand.hand.kinematics.gradients import chain_gradients, column_spin
from torchhand.hand.kinematics.joint_rotations import free_axes, local_rotations
from torchhand.precision import own_precision

_LEVELS = ((0, 1, 1, 6), (1, 6, 6, 11), (6, 11, 11, 16), (12, 16, 16, 20))
"""First and last-but-one of the parents, then of the bones of each level; the thumb ends one level early."""
_THUMB_TIP_LEVER = 15
_HINGES = len(HINGES)


def place_chain(
    pose: Float[Tensor, "36 n"],
    reference: Float[Tensor, "3 3 #n"] | None,
    levers: Float[Tensor, "24 3 #n"],
    constants: ChainConstants,
) -> tuple[Float[Tensor, "20 3 3 n"], Float[Tensor, "20 3 n"], Float[Tensor, "21 3 n"]]:
    """world_from_bone, origins of the bones and keypoints; the batch stands last.

    reference: world_from_hand = exp(pose[3:6]) · reference. Its gradient is the tangent one: right for a reference
    that stays a rotation. levers: the offset at the end of every bone in that bone's frame, in the order of LEVER_ENDS.
    """
    if torch.compiler.is_compiling():
        return place_chain_compiled(pose, reference, levers, constants)
    if is_without_derivatives():
        return _Chain.forward(pose, reference, levers, constants)  # no derivative can be asked for
    if _forward_modes() > 1:
        return place_chain_plainly(pose, reference, levers, constants)
    return _Chain.apply(pose, reference, levers, constants)


def _forward_modes() -> int:
    """How many forward modes of torch.func are nested here.

    torch takes the derivative of a Function's own `jvp` in forward mode for zero, without a word.
    """
    if not torch._C._are_functorch_transforms_active():
        return 0
    return sum(level.key() == TransformType.Jvp for level in get_interpreter_stack() or ())


class _Chain(torch.autograd.Function):
    @staticmethod
    def forward(
        pose: Tensor, reference: Tensor | None, levers: Tensor, constants: ChainConstants
    ) -> tuple[Tensor, Tensor, Tensor]:
        # No derivative is recorded in here: results are written where they belong.
        count = pose.shape[-1]
        if count == 1 and levers.shape[-1] == 1:
            return _one_placed(pose, reference, levers, constants)
        rotation, position = pose.new_empty(20, 3, 3, count), pose.new_empty(20, 3, count)
        root = _exponential(pose[3:6], constants)
        rotation[0] = root if reference is None else compose(root[None], reference[None])[0]
        local = local_rotations(pose, constants)
        for first, last, start, stop in _LEVELS:
            out = rotation[start:stop]
            columns, rows = rotation[first:last].chunk(3, 2), local[start - 1 : stop - 1].chunk(3, 1)
            torch.mul(columns[0], rows[0], out=out)
            out.addcmul_(columns[1], rows[1]).addcmul_(columns[2], rows[2])
        spans = torch.cat((turn(rotation[:1], levers[:5]), turn(rotation[1:], levers[5:])))
        position[0] = pose[:3]
        for (first, last, start, stop), span in zip(_LEVELS, _by_level(spans), strict=True):
            torch.add(position[first:last], span, out=position[start:stop])
        thumb_tip = position[11:12] + spans[_THUMB_TIP_LEVER : _THUMB_TIP_LEVER + 1]
        points = torch.cat((position, thumb_tip, position[16:] + spans[20:]))
        return rotation, position, points.index_select(0, constants.keypoint_points)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple, output: tuple) -> None:
        pose, reference, levers, constants = inputs
        rotation, position, keypoints = output
        saved = (pose, reference, levers, rotation, position, keypoints)
        ctx.save_for_backward(*saved)
        ctx.save_for_forward(*saved)
        ctx.constants = constants
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, Tensor | None, Tensor | None, None]:
        pose, reference, levers, rotation, position, keypoints = ctx.saved_tensors
        _, needs_reference, needs_levers, _ = ctx.needs_input_grad
        of_pose, of_reference, of_levers = chain_gradients(
            pose,
            reference,
            levers,
            (rotation, position, keypoints),
            ctx.constants,
            gradients,
            needs_reference=needs_reference,
            needs_levers=needs_levers,
        )
        return of_pose, of_reference, of_levers, None

    @staticmethod
    @own_precision
    def jvp(ctx: Any, *tangents: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Velocities gathered from the root to the tips."""
        pose, reference, levers, rotation, _, _ = ctx.saved_tensors
        constants: ChainConstants = ctx.constants
        along_pose, along_reference, along_levers = tangents[:3]
        along_pose = torch.zeros_like(pose) if along_pose is None else along_pose
        vector, rate = pose[3:6], along_pose[3:6]
        first_order, second_order, third_order = exponential_coefficients((vector * vector).sum(0))
        once = cross(vector[None], rate[None])[0]
        root_spin = rate + second_order * once + third_order * cross(vector[None], once[None])[0]
        if reference is not None and along_reference is not None:
            own = 0.5 * column_spin(reference[None], along_reference[None])[0]
            turned = cross(vector[None], own[None])[0]
            root_spin = root_spin + own + first_order * turned + second_order * cross(vector[None], turned[None])[0]
        relative = turn(rotation[1:], _angle_rates(along_pose, pose, constants))
        spin = _accumulated(root_spin[None], relative, _LEVELS)
        spans = torch.cat((turn(rotation[:1], levers[:5]), turn(rotation[1:], levers[5:])))
        velocity = cross(torch.cat((spin[:1].expand(5, *spin.shape[1:]), spin[1:])), spans)
        if along_levers is not None:
            velocity = velocity + torch.cat(
                (turn(rotation[:1], along_levers[:5]), turn(rotation[1:], along_levers[5:]))
            )
        moves = _accumulated(along_pose[None, :3], torch.cat(_by_level(velocity)), _LEVELS)
        thumb_tip = moves[11:12] + velocity[_THUMB_TIP_LEVER : _THUMB_TIP_LEVER + 1]
        of_keypoints = torch.cat((moves, thumb_tip, moves[16:] + velocity[20:])).index_select(
            0, constants.keypoint_points
        )
        turning = torch.stack([cross(spin, rotation[:, :, j]) for j in range(3)], 2)
        return turning, moves, of_keypoints

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple, pose: Tensor, reference: Tensor | None, levers: Tensor, constants: ChainConstants
    ) -> tuple[tuple[Tensor, Tensor, Tensor], tuple[int, int, int]]:
        """The mapped dimension joins the batch."""
        size, count = info.batch_size, pose.shape[-1] if in_dims[0] is None else pose.movedim(in_dims[0], 0).shape[-1]

        def joined(tensor: Tensor, dim: int | None, *, keep_shared: bool) -> Tensor:
            if dim is None and keep_shared and tensor.shape[-1] == 1:
                return tensor
            mapped = tensor[..., None, :] if dim is None else tensor.movedim(dim, -2)
            return mapped.expand(*mapped.shape[:-2], size, count).flatten(-2)

        flat_pose = joined(pose, in_dims[0], keep_shared=False)
        flat_reference = None if reference is None else joined(reference, in_dims[1], keep_shared=True)
        outputs = _Chain.apply(flat_pose, flat_reference, joined(levers, in_dims[2], keep_shared=True), constants)
        rotation, position, keypoints = (x.unflatten(-1, (size, count)) for x in outputs)
        return (rotation, position, keypoints), (3, 2, 2)


def _one_placed(
    pose: Tensor, reference: Tensor | None, levers: Tensor, constants: ChainConstants
) -> tuple[Tensor, Tensor, Tensor]:
    """`_Chain.forward` of a batch of one hand, whose matrices are multiplied as such: in a third of the operations."""
    root = _exponential(pose[3:6], constants).movedim(-1, 0)
    root = root if reference is None else root @ reference.movedim(-1, 0)
    local = local_rotations(pose, constants)[..., 0]
    first = root @ local[:5]
    second = first @ local[5:10]
    third = second @ local[10:15]
    rotation = torch.cat((root, first, second, third, third[1:] @ local[15:]))
    spans = torch.cat((root @ levers[:5], rotation[1:] @ levers[5:]))
    wrist = pose[None, :3]
    places = [wrist]
    for start, stop in ((0, 5), (5, 10), (10, 15)):
        places.append(places[-1] + spans[start:stop])
    places.append(places[-1][1:] + spans[16:20])
    position = torch.cat(places)
    tips = (places[3][:1] + spans[_THUMB_TIP_LEVER : _THUMB_TIP_LEVER + 1], places[4] + spans[20:])
    keypoints = torch.cat((position, *tips)).index_select(0, constants.keypoint_points)
    return rotation[..., None], position, keypoints


def _by_level(spans: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The levers that lead to the bones of each level."""
    return spans[:5], spans[5:10], spans[10:15], spans[16:20]


def _accumulated(root: Tensor, steps: Tensor, levels: tuple[tuple[int, int, int, int], ...]) -> Tensor:
    """Sums of the steps from the root to every bone."""
    sums = [root]
    for first, last, start, stop in levels:
        parents = sums[-1] if last - first == sums[-1].shape[0] else sums[-1][1:]
        sums.append(parents + steps[start - 1 : stop - 1])
    return torch.cat(sums)


def _exponential(vector: Tensor, constants: ChainConstants) -> Tensor:
    """rotation_from_vector with the batch last; not differentiable at zero."""
    turns = (vector * vector).sum(0).sqrt() / torch.pi
    first, second = torch.sinc(turns), 0.5 * torch.sinc(0.5 * turns).square()
    products = (second * vector)[:, None] * vector[None]
    basis = torch.cat((first * vector, products.flatten(0, 1)))
    return torch.addmm(constants.identity, constants.root_rotation, basis).unflatten(0, (3, 3))


def _angle_rates(along_pose: Tensor, pose: Tensor, constants: ChainConstants) -> Tensor:
    """Angular velocity of every bone relative to its parent, in the bone's frame: (19, 3, n)."""
    rates = along_pose.index_select(0, constants.angles)
    hinge = constants.hinge_axis * rates[:_HINGES, None]
    free = (free_axes(pose, constants) * rates[_HINGES:].unflatten(0, (-1, 3))[:, :, None]).sum(1)
    return torch.cat((free[:1], hinge[:4], free[1:], hinge[4:]))
