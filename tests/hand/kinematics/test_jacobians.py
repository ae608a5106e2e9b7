"""Closed-form derivatives of the keypoints against reverse-mode differentiation."""

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand.kinematics.jacobians import (
    KEYPOINT_BONES,
    PoseJacobian,
    ShapeJacobian,
    keypoint_jacobian,
)
from torchhand.hand.kinematics.kinematics import HandKinematics, Side
from torchhand.hand.kinematics.pose import named_pose_space
from torchhand.hand.kinematics.skeleton import DOFS, KEYPOINTS

SIDES: tuple[Side, ...] = ("right", "left")
BATCHES = [(), (1,), (2, 3)]


def _hand(side: Side) -> HandKinematics:
    return load_hand_model().kinematics(side, dtype=torch.float64)


def _random(kinematics: HandKinematics, batch: tuple[int, ...], generator: torch.Generator) -> tuple[Tensor, ...]:
    pose = 0.7 * torch.randn(*batch, len(DOFS), generator=generator, dtype=torch.float64)
    noise = torch.randn(*batch, len(kinematics.default_shape), generator=generator, dtype=torch.float64)
    reference = rotation_from_vector(torch.randn(*batch, 3, generator=generator, dtype=torch.float64))
    return pose, kinematics.default_shape * (1 + 0.05 * noise), reference


def _by_autograd(kinematics: HandKinematics, pose: Tensor, shape: Tensor, reference: Tensor) -> tuple[Tensor, Tensor]:
    def keypoints(pose: Tensor, shape: Tensor, reference: Tensor) -> Tensor:
        return kinematics(pose, shape, root_reference=reference).keypoints

    rows = zip(pose.reshape(-1, 36), shape.reshape(-1, shape.shape[-1]), reference.reshape(-1, 3, 3), strict=True)
    pairs = [torch.func.jacrev(keypoints, argnums=(0, 1))(*row) for row in rows]
    of_pose, of_shape = (torch.stack(parts) for parts in zip(*pairs, strict=True))
    batch = pose.shape[:-1]
    return of_pose.reshape(*batch, 21, 3, 36), of_shape.reshape(*batch, 21, 3, -1)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("batch", BATCHES)
def test_both_agree_with_autograd(side: Side, batch: tuple[int, ...], generator: torch.Generator) -> None:
    kinematics = _hand(side)
    pose, shape, reference = _random(kinematics, batch, generator)
    frames = kinematics(pose, shape, root_reference=reference)
    of_pose, of_shape = _by_autograd(kinematics, pose, shape, reference)
    torch.testing.assert_close(keypoint_jacobian(kinematics, pose, frames), of_pose, atol=1e-12, rtol=0)
    torch.testing.assert_close(ShapeJacobian(kinematics)(frames, shape), of_shape, atol=1e-12, rtol=0)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (3e-5, -2e-5, 0.0), (0.0, 3.14159, 0.0)])
def test_the_root_near_singular_rotations(vector: tuple[float, float, float], generator: torch.Generator) -> None:
    kinematics = _hand("right")
    pose, shape, _ = _random(kinematics, (), generator)
    pose[3:6] = torch.tensor(vector, dtype=torch.float64)
    frames = kinematics(pose, shape)
    expected, _ = _by_autograd(kinematics, pose, shape, torch.eye(3, dtype=torch.float64))
    torch.testing.assert_close(keypoint_jacobian(kinematics, pose, frames), expected, atol=1e-8, rtol=0)


@pytest.mark.parametrize("name", ["planar", "planar_abduction", "dof26", "dof27", "dof31", "dof36"])
def test_pose_spaces_get_their_own_columns(name: str, generator: torch.Generator) -> None:
    kinematics = _hand("left")
    pose, shape, reference = _random(kinematics, (4,), generator)
    frames = kinematics(pose, shape, root_reference=reference)
    basis = named_pose_space(name).basis
    expected = keypoint_jacobian(kinematics, pose, frames) @ basis
    torch.testing.assert_close(keypoint_jacobian(kinematics, pose, frames, basis=basis), expected, atol=1e-14, rtol=0)


def test_any_basis_is_taken(generator: torch.Generator) -> None:
    """Synergies: every parameter moves every joint and the root."""
    kinematics = _hand("right")
    pose, shape, reference = _random(kinematics, (3,), generator)
    basis = torch.randn(36, 5, generator=generator, dtype=torch.float64)
    frames = kinematics(pose, shape, root_reference=reference)
    expected = keypoint_jacobian(kinematics, pose, frames) @ basis
    torch.testing.assert_close(PoseJacobian(kinematics, basis)(pose, frames), expected, atol=1e-12, rtol=0)


def test_chosen_shape_columns(generator: torch.Generator) -> None:
    kinematics = _hand("right")
    pose, shape, _ = _random(kinematics, (2,), generator)
    frames = kinematics(pose, shape)
    names = kinematics.shape_space.names
    columns = [names.index(name) for name in ("little_distal", "hand_breadth", "index_tip_radius", "hand_length")]
    expected = ShapeJacobian(kinematics)(frames, shape)[..., columns]
    torch.testing.assert_close(ShapeJacobian(kinematics, columns)(frames, shape), expected, atol=1e-14, rtol=0)
    assert float(expected[..., 2].abs().max()) == 0  # a radius moves no joint


def test_one_shape_for_the_whole_batch(generator: torch.Generator) -> None:
    kinematics = _hand("left")
    pose, shape, _ = _random(kinematics, (3,), generator)
    frames = kinematics(pose, shape[0])
    expected = ShapeJacobian(kinematics)(frames, shape[0].expand(3, -1))
    torch.testing.assert_close(ShapeJacobian(kinematics)(frames, shape[0]), expected, atol=1e-14, rtol=0)


def test_points_fixed_to_the_bones_of_keypoints(generator: torch.Generator) -> None:
    """A point that is moved away from a keypoint along with the bone that ends there has the same movers."""
    kinematics = _hand("right")
    pose, shape, _ = _random(kinematics, (), generator)
    arms = 0.01 * torch.randn(21, 3, generator=generator, dtype=torch.float64)

    def points(pose: Tensor) -> Tensor:
        frames = kinematics(pose, shape)
        return frames.keypoints + (frames.rotation[list(KEYPOINT_BONES)] @ arms[..., None]).squeeze(-1)

    frames = kinematics(pose, shape)
    found = PoseJacobian(kinematics).batch_last(
        pose[:, None], frames.rotation[..., None], frames.position[..., None], points(pose)[..., None]
    )
    torch.testing.assert_close(found[..., 0], torch.func.jacrev(points)(pose), atol=1e-12, rtol=0)
    assert KEYPOINT_BONES[KEYPOINTS.index("index_mcp")] == 2  # the index's metacarpal
    assert KEYPOINT_BONES[KEYPOINTS.index("thumb_tip")] == 11
