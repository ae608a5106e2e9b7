"""Closed-form derivative of skin points in the pose: against torch.func, near zero, in batches."""

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand.hand import Hand
from torchhand.hand.model import HandModel
from torchhand.hand.skin_jacobian import skin_jacobian

TOLERANCE = 1e-13
POINTS, CORNERS, VERTICES = 7, 3, 24


def _draw(batch: tuple[int, ...], generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Pose, corners and barycentric weights."""
    pose = 0.7 * torch.randn(*batch, 36, generator=generator, dtype=torch.float64)
    corners = torch.randint(VERTICES, (*batch, POINTS, CORNERS), generator=generator)
    weights = torch.rand(*batch, POINTS, CORNERS, generator=generator, dtype=torch.float64)
    return pose, corners, weights / weights.sum(-1, keepdim=True)


def _shape(hand: Hand, generator: torch.Generator, *batch: int) -> Tensor:
    noise = torch.randn(*batch, len(hand.shape), generator=generator, dtype=torch.float64)
    return hand.shape * (1 + 0.05 * noise)


def _by_autograd(
    hand: Hand, pose: Tensor, corners: Tensor, weights: Tensor, shape: Tensor, reference: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Of one hand: the points and torch.func's Jacobian of them."""

    def points(pose: Tensor) -> Tensor:
        return (hand(pose, shape, root_reference=reference).vertices[corners] * weights[..., None]).sum(-2)

    return points(pose), torch.func.jacrev(points)(pose)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("batch", [(), (1,), (2, 2)])
def test_agrees_with_autograd(
    side: str, batch: tuple[int, ...], small_model: HandModel, generator: torch.Generator
) -> None:
    """Other points, shapes and references for every hand; rotation vector, angles and correctives alike."""
    hand = small_model.hand(side="left" if side == "left" else "right", dtype=torch.float64)
    pose, corners, weights = _draw(batch, generator)
    shape = _shape(hand, generator, *batch)
    reference = rotation_from_vector(torch.randn(*batch, 3, generator=generator, dtype=torch.float64))
    points, jacobian = skin_jacobian(hand, pose, corners, weights, shape=shape, root_reference=reference)
    assert jacobian.shape == (*batch, POINTS, 3, 36)
    rows = [x.reshape(-1, *x.shape[len(batch) :]) for x in (pose, corners, weights, shape, reference)]
    expected = [_by_autograd(hand, *row) for row in zip(*rows, strict=True)]
    torch.testing.assert_close(points, torch.stack([e[0] for e in expected]).reshape(points.shape), atol=1e-14, rtol=0)
    of_all = torch.stack([e[1] for e in expected]).reshape(jacobian.shape)
    torch.testing.assert_close(jacobian, of_all, atol=TOLERANCE, rtol=0)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 1e-3, 3.1])
def test_near_the_singular_points_of_the_rotation_vector(
    angle: float, small_model: HandModel, generator: torch.Generator
) -> None:
    hand = small_model.hand(dtype=torch.float64)
    pose, corners, weights = _draw((), generator)
    pose[3:6] *= angle / pose[3:6].norm()
    _, jacobian = skin_jacobian(hand, pose, corners, weights)
    _, expected = _by_autograd(hand, pose, corners, weights, hand.shape, None)
    torch.testing.assert_close(jacobian, expected, atol=1e-12, rtol=0)


def test_vertices_shared_by_all_hands(small_model: HandModel, generator: torch.Generator) -> None:
    """Vertices by their indices alone; corners without weights are averaged."""
    hand = small_model.hand(dtype=torch.float64)
    pose, corners, _ = _draw((4,), generator)
    vertices = corners[0, :, :1]
    points, jacobian = skin_jacobian(hand, pose, vertices)
    torch.testing.assert_close(points, hand(pose).vertices[:, vertices[:, 0]], atol=1e-14, rtol=0)
    centres, of_centres = skin_jacobian(hand, pose, corners[0])
    for i in range(4):
        one, third = torch.ones(POINTS, 1).double(), torch.full((POINTS, 3), 1 / 3, dtype=torch.float64)
        _, expected = _by_autograd(hand, pose[i], vertices, one, hand.shape, None)
        torch.testing.assert_close(jacobian[i], expected, atol=TOLERANCE, rtol=0)
        centre, expected = _by_autograd(hand, pose[i], corners[0], third, hand.shape, None)
        torch.testing.assert_close(centres[i], centre, atol=1e-14, rtol=0)
        torch.testing.assert_close(of_centres[i], expected, atol=TOLERANCE, rtol=0)


def test_is_itself_differentiable(small_model: HandModel, generator: torch.Generator) -> None:
    hand = small_model.hand(dtype=torch.float64)
    pose, corners, weights = _draw((), generator)
    shape = _shape(hand, generator).requires_grad_()

    def jacobian(pose: Tensor, weights: Tensor, shape: Tensor) -> Tensor:
        return skin_jacobian(hand, pose, corners[:2], weights, shape=shape)[1]

    inputs = (pose.requires_grad_(), weights[:2].clone().requires_grad_(), shape)
    assert torch.autograd.gradcheck(jacobian, inputs, fast_mode=True)


def test_a_pose_of_another_length_is_refused() -> None:
    hand = load_hand_model().hand(dtype=torch.float64)
    with pytest.raises(ValueError, match=r"pose: expected 36 numbers in the last dimension, got shape \(35,\)"):
        skin_jacobian.__wrapped__.__wrapped__(  # pyright: ignore
            hand, torch.zeros(35, dtype=torch.float64), torch.zeros(1, 3, dtype=torch.long)
        )
