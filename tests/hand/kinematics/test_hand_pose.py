"""A pose with its reference: steps and their inverses, the rotation kept whatever the reference, any batch shape."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand.kinematics import HandPose

BATCHES = [(), (1,), (2, 3)]


def normal(generator: torch.Generator, *size: int) -> Tensor:
    return torch.randn(*size, generator=generator, dtype=torch.float64)


def poses(generator: torch.Generator, *batch: int, turn: float = 1.0) -> HandPose:
    """With rotation vectors on top of references that turn any way."""
    dofs = normal(generator, *batch, 36)
    dofs[..., 3:6] *= turn
    return HandPose(dofs=dofs, reference=rotation_from_vector(2 * normal(generator, *batch, 3)))


def same_hands(one: HandPose, other: HandPose) -> None:
    """Whatever their references."""
    kept = torch.arange(36) // 3 != 1
    torch.testing.assert_close(one.dofs[..., kept], other.dofs[..., kept], atol=1e-12, rtol=0)
    torch.testing.assert_close(one.rotation, other.rotation, atol=1e-12, rtol=0)


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.7, math.pi - 1e-3])
def test_a_step_is_undone_by_reading_it(batch: tuple[int, ...], angle: float, generator: torch.Generator) -> None:
    """retract and step_to are each other's inverse, up to half a turn."""
    here, step = poses(generator, *batch), normal(generator, *batch, 36)
    step[..., 3:6] *= angle / step[..., 3:6].norm(dim=-1, keepdim=True)
    there = here.retract(step)
    assert there.batch_shape == torch.Size(batch)
    assert not bool(there.dofs[..., 3:6].any())
    torch.testing.assert_close(here.step_to(there), step, atol=1e-9, rtol=0)
    other = poses(generator, *batch)
    same_hands(here.retract(here.step_to(other)), other)


def test_a_rotation_is_a_left_perturbation(generator: torch.Generator) -> None:
    here, turn = poses(generator), 0.3 * normal(generator, 3)
    step = torch.nn.functional.pad(turn, (3, 30))
    torch.testing.assert_close(here.retract(step).rotation, rotation_from_vector(turn) @ here.rotation)


@pytest.mark.parametrize("batch", BATCHES)
def test_the_hand_is_the_same_about_any_reference(batch: tuple[int, ...], generator: torch.Generator) -> None:
    hands = poses(generator, *batch)
    other = rotation_from_vector(2 * normal(generator, *batch, 3))
    same_hands(hands.normalized(), hands)
    assert not bool(hands.normalized().dofs[..., 3:6].any())
    about = hands.about(other)
    same_hands(about, hands)
    assert torch.equal(about.reference, other)
    torch.testing.assert_close(hands.about(hands.rotation).dofs[..., 3:6], torch.zeros(*batch, 3).double())
    turned = hands.vector
    torch.testing.assert_close(rotation_from_vector(turned[..., 3:6]), hands.rotation, atol=1e-12, rtol=0)
    assert bool((turned[..., 3:6].norm(dim=-1) <= math.pi + 1e-12).all())


def test_steps_do_not_depend_on_the_references(generator: torch.Generator) -> None:
    one, other = poses(generator, 4), poses(generator, 4)
    references = rotation_from_vector(2 * normal(generator, 4, 3))
    torch.testing.assert_close(one.about(references).step_to(other.normalized()), one.step_to(other), atol=1e-9, rtol=0)


OPERATIONS: dict[str, Callable[[HandPose, HandPose], Tensor]] = {
    "rotation": lambda one, other: one.rotation,
    "vector": lambda one, other: one.vector,
    "normalized": lambda one, other: one.normalized().reference,
    "retract": lambda one, other: one.retract(0.3 * other.dofs).reference,
    "step_to": lambda one, other: one.step_to(other),
    "about": lambda one, other: one.about(other.reference).dofs,
}


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("name", OPERATIONS)
def test_batches_equal_a_loop(name: str, batch: tuple[int, ...], generator: torch.Generator) -> None:
    operation, one, other = OPERATIONS[name], poses(generator, *batch), poses(generator, *batch)
    whole = operation(one, other)
    flat, beside = one.reshape(-1), other.reshape(-1)
    parts = torch.stack([operation(flat[i], beside[i]) for i in range(len(flat))])
    torch.testing.assert_close(whole.reshape(parts.shape), parts, atol=1e-12, rtol=0)


def test_gradients_flow_through_steps(generator: torch.Generator) -> None:
    """Also at a step of no length, where lengths of vectors have no derivative."""
    here = poses(generator, 2)
    for scale in (0.4, 0.0):
        step = (scale * normal(generator, 2, 36)).requires_grad_()

        def read(step: Tensor) -> Tensor:
            return here.step_to(here.retract(step))

        assert torch.autograd.gradcheck(read, (step,), atol=1e-6)


def test_records_are_joined_cut_and_repeated(generator: torch.Generator) -> None:
    one, other = poses(generator, 2), poses(generator, 3)
    both = HandPose.cat((one, other))
    assert len(both) == 5
    same_hands(both[2:], other)
    same_hands(both[torch.tensor([4, 0])], HandPose.stack((other[2], one[0])))
    repeated = one[0].expand(4)
    assert repeated.batch_shape == (4,)
    same_hands(repeated[3], one[0])
    assert both.reshape(5, 1).batch_shape == (5, 1)
    shared = HandPose.of(one.dofs, other.reference[0])
    assert torch.equal(shared.reference[1], other.reference[0])
    plain = HandPose.of(one.dofs)
    torch.testing.assert_close(plain.rotation, rotation_from_vector(one.dofs[:, 3:6]))
    same_hands(
        both.to(torch.zeros((), dtype=torch.float32)).to(both.dofs),
        HandPose.of(both.dofs.float().double(), both.reference.float().double()),
    )


def test_a_rotation_vector_longer_than_half_a_turn_is_read_as_the_shorter_one() -> None:
    turn = torch.tensor((0.0, 0.0, 1.5 * math.pi), dtype=torch.float64)
    hand = HandPose.of(torch.nn.functional.pad(turn, (3, 30)))
    torch.testing.assert_close(hand.vector[3:6], vector_from_rotation(rotation_from_vector(turn)))
    torch.testing.assert_close(float(hand.vector[5]), -0.5 * math.pi)
