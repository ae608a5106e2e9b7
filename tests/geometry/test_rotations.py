"""Rotation vectors and matrices: laws, derivatives, the neighbourhoods of zero and of half a turn."""

import math

import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from torchhand.geometry.rotations import (
    cosine_between,
    left_jacobian,
    ordered_product,
    rotation_from_columns,
    rotation_from_vector,
    skew,
    vector_from_rotation,
)


def _vectors(generator: torch.Generator, count: int = 200) -> Tensor:
    """Directions of every kind with lengths from nothing to half a turn, both ends included."""
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)
    special = torch.tensor((0.0, 1e-12, 1e-8, 1e-5, 9.9e-5, 1.1e-4, 1e-3, 3.0, math.pi - 1e-4, math.pi - 1e-7))
    length = torch.cat((special.double(), torch.rand(count - len(special), generator=generator).double() * math.pi))
    return direction * length[:, None]


def test_agrees_with_scipy(generator: torch.Generator) -> None:
    vectors = _vectors(generator)
    expected = torch.from_numpy(Rotation.from_rotvec(vectors.numpy()).as_matrix())
    torch.testing.assert_close(rotation_from_vector(vectors), expected, atol=1e-14, rtol=0)


def test_is_a_rotation(generator: torch.Generator) -> None:
    rotation = rotation_from_vector(_vectors(generator))
    identity = torch.eye(3, dtype=torch.float64).expand_as(rotation)
    torch.testing.assert_close(rotation @ rotation.mT, identity, atol=1e-14, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(len(rotation), dtype=torch.float64))


def test_logarithm_inverts_the_exponential(generator: torch.Generator) -> None:
    vectors = _vectors(generator)
    torch.testing.assert_close(vector_from_rotation(rotation_from_vector(vectors)), vectors, atol=1e-9, rtol=0)


def test_half_a_turn_comes_back_as_the_same_rotation() -> None:
    for axis in torch.eye(3, dtype=torch.float64):
        rotation = rotation_from_vector(math.pi * axis)
        vector = vector_from_rotation(rotation)
        torch.testing.assert_close(vector.norm(), torch.tensor(math.pi, dtype=torch.float64))
        torch.testing.assert_close(rotation_from_vector(vector), rotation, atol=1e-14, rtol=0)


def test_skew_is_the_cross_product(generator: torch.Generator) -> None:
    a, b = torch.randn(2, 7, 3, generator=generator, dtype=torch.float64)
    product = (skew(a) @ b[..., None]).squeeze(-1)
    torch.testing.assert_close(product, torch.linalg.cross(a, b), atol=1e-15, rtol=0)


@pytest.mark.parametrize("length", [0.0, 1e-6, 9.999e-5, 1.0001e-4, 0.7, math.pi, 5.0])
def test_left_jacobian_is_the_derivative(length: float, generator: torch.Generator) -> None:
    """exp(v + dv) = exp(J dv) exp(v), by central differences with a step that leaves 1e-9."""
    vector = length * torch.nn.functional.normalize(torch.randn(3, generator=generator, dtype=torch.float64), dim=0)
    here, step = rotation_from_vector(vector), 1e-5
    columns = []
    for shift in step * torch.eye(3, dtype=torch.float64):
        ahead, behind = rotation_from_vector(vector + shift) @ here.T, rotation_from_vector(vector - shift) @ here.T
        columns.append((vector_from_rotation(ahead) - vector_from_rotation(behind)) / (2 * step))
    torch.testing.assert_close(left_jacobian(vector), torch.stack(columns, -1), atol=1e-9, rtol=0)


@pytest.mark.parametrize("length", [0.0, 1e-6, 0.7, 3.0])
def test_derivatives(length: float, generator: torch.Generator) -> None:
    vector = length * torch.nn.functional.normalize(torch.randn(3, generator=generator, dtype=torch.float64), dim=0)
    vector.requires_grad_()
    assert torch.autograd.gradcheck(rotation_from_vector, (vector,))
    assert torch.autograd.gradgradcheck(rotation_from_vector, (vector,))
    assert torch.autograd.gradcheck(left_jacobian, (vector,))
    assert torch.autograd.gradcheck(lambda v: vector_from_rotation(rotation_from_vector(v)), (vector,))


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], generator: torch.Generator) -> None:
    vectors = torch.randn(*batch, 3, generator=generator, dtype=torch.float64)
    flat = vectors.reshape(-1, 3)
    for function in (rotation_from_vector, left_jacobian, skew):
        expected = torch.stack([function(v) for v in flat]).reshape(*batch, 3, 3)
        torch.testing.assert_close(function(vectors), expected, atol=1e-15, rtol=1e-15)
    rotation = rotation_from_vector(vectors)
    expected = torch.stack([vector_from_rotation(r) for r in rotation.reshape(-1, 3, 3)]).reshape(*batch, 3)
    torch.testing.assert_close(vector_from_rotation(rotation), expected, atol=1e-15, rtol=1e-15)


def test_one_hand_has_the_bits_that_it_has_in_a_batch(generator: torch.Generator) -> None:
    """What a live stream says hand by hand is what a file says that was written at once."""
    vectors = _vectors(generator)
    points = torch.randn(len(vectors), 21, 3, generator=generator, dtype=torch.float64)
    rotations = rotation_from_vector(vectors)
    turned = ordered_product(points, rotations)
    torch.testing.assert_close(turned, points @ rotations, atol=1e-14, rtol=1e-14)
    for one, point, rotation, expected in zip(vectors, points, rotations, turned, strict=True):
        assert torch.equal(rotation_from_vector(one), rotation)
        assert torch.equal(ordered_product(point, rotation), expected)


def test_float32_keeps_its_precision() -> None:
    vector = torch.tensor((3e-4, -2e-4, 1e-4))
    exact = rotation_from_vector(vector.double())
    torch.testing.assert_close(rotation_from_vector(vector).double(), exact, atol=1.2e-7, rtol=0)
    back = vector_from_rotation(rotation_from_vector(vector))
    torch.testing.assert_close(back, vector, atol=1e-7, rtol=0)


def test_rotations_from_columns() -> None:
    generator = torch.Generator().manual_seed(2)
    columns = torch.randn(50, 6, generator=generator, dtype=torch.float64)
    rotation = rotation_from_columns(columns)
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3, dtype=torch.float64).expand(50, 3, 3))
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(50, dtype=torch.float64))
    again = rotation_from_columns(torch.cat((rotation[..., 0], rotation[..., 1]), -1))
    torch.testing.assert_close(again, rotation)
    cross = torch.linalg.cross(columns[:, :3], columns[:, 3:])
    torch.testing.assert_close(torch.nn.functional.normalize(cross, dim=-1), rotation[..., 2])
    assert torch.autograd.gradcheck(rotation_from_columns, columns[:3].requires_grad_())


def test_the_cosine_between_rotations_is_that_of_the_turn_from_one_to_the_other(generator: torch.Generator) -> None:
    vectors = _vectors(generator)
    first = rotation_from_vector(_vectors(generator))
    found = cosine_between(rotation_from_vector(vectors) @ first, first)
    torch.testing.assert_close(found, vectors.norm(dim=-1).cos(), atol=1e-14, rtol=0)


def test_rotation_is_the_same_where_no_derivative_is_asked_for(generator: torch.Generator) -> None:
    vectors = _vectors(generator)
    expected = rotation_from_vector(vectors)
    with torch.inference_mode():
        torch.testing.assert_close(rotation_from_vector(vectors), expected, atol=1e-14, rtol=0)
