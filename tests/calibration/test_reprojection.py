"""Reprojection of board corners against OpenCV, and its derivatives against automatic ones."""

import cv2
import numpy as np
import pytest
import torch

from torchhand.calibration.reprojection import Pose, central_pose, coefficient_jacobian, reproject
from torchhand.geometry import distort, rotation_from_vector

POINTS = torch.tensor([[0.0, 0.0, 0.0], [0.1, 0.02, 0.0], [0.03, 0.12, 0.01]], dtype=torch.float64)


def pose(*values: float) -> Pose:
    vector = torch.tensor(values[:3], dtype=torch.float64)
    return Pose(rotation=rotation_from_vector(vector), translation=torch.tensor(values[3:], dtype=torch.float64))


CAMERA = pose(0.2, -0.3, 0.1, 0.05, -0.02, 0.6)
BOARDS = Pose.stacked(
    [pose(0.4, 0.1, 0.2, 0.0, 0.1, 0.0), pose(-0.3, 0.2, 0.0, 0.05, 0.0, 0.1), pose(0, 0, 0, 0, 0, 0)]
)


def lens(coefficients: int) -> torch.Tensor:
    more = torch.linspace(-0.1, 0.13, 8, dtype=torch.float64)[:coefficients]
    return torch.cat((torch.tensor((610.0, 605.0, 322.0, 236.0), dtype=torch.float64), more))


@pytest.mark.parametrize("coefficients", [0, 4, 5, 8])
def test_pixels_are_opencvs(coefficients: int) -> None:
    values = lens(coefficients)
    seen = reproject(values, CAMERA, BOARDS, POINTS)
    world = (BOARDS.rotation @ POINTS[..., None]).squeeze(-1) + BOARDS.translation
    turn = cv2.Rodrigues(CAMERA.rotation.numpy())[0]
    matrix = np.array([[610.0, 0, 322.0], [0, 605.0, 236.0], [0, 0, 1]])
    expected, _ = cv2.projectPoints(
        world.numpy(), turn, CAMERA.translation.numpy(), matrix, values[4:].numpy() if coefficients else None
    )
    torch.testing.assert_close(seen.points_px, torch.from_numpy(expected.reshape(-1, 2)), atol=1e-9, rtol=0.0)


@pytest.mark.parametrize("coefficients", [0, 4, 5, 8])
def test_derivatives(coefficients: int) -> None:
    zero = torch.zeros(6, dtype=torch.float64)

    def pixels(values: torch.Tensor, camera: torch.Tensor, board: torch.Tensor) -> torch.Tensor:
        moved = [
            Pose(
                rotation=rotation_from_vector(change[:3]) @ at.rotation,
                translation=at.translation + change[3:],
            )
            for change, at in ((camera, CAMERA), (board, BOARDS))
        ]
        return reproject(values, moved[0], moved[1], POINTS).points_px

    seen = reproject(lens(coefficients), CAMERA, BOARDS, POINTS)
    expected = torch.func.jacrev(pixels, argnums=(0, 1, 2))(lens(coefficients), zero, zero)
    for found, true in zip((seen.by_lens, seen.by_camera, seen.by_board), expected, strict=True):
        torch.testing.assert_close(found, true, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_derivative_with_coefficients(batch: tuple[int, ...], generator: torch.Generator) -> None:
    plane = torch.rand(*batch, 2, generator=generator, dtype=torch.float64) - 0.5
    coefficients = lens(8)[4:]
    expected = torch.func.jacrev(lambda k: distort(plane, k))(coefficients)
    torch.testing.assert_close(coefficient_jacobian(plane, coefficients), expected, atol=1e-12, rtol=1e-12)


def test_poses_form_a_group() -> None:
    there = CAMERA @ BOARDS[0]
    back = there.inverse() @ CAMERA @ BOARDS[0]
    torch.testing.assert_close(back.rotation, torch.eye(3).double(), atol=1e-14, rtol=0.0)
    torch.testing.assert_close(back.translation, torch.zeros(3).double(), atol=1e-14, rtol=0.0)
    torch.testing.assert_close((Pose.identity() @ CAMERA).translation, CAMERA.translation, atol=0.0, rtol=0.0)


def test_central_pose_is_no_outlier() -> None:
    near = [pose(0.1 + d, 0.2, 0.0, 0.0, 0.0, 0.5 + d) for d in (-0.02, 0.0, 0.01)]
    poses = Pose.stacked([pose(2.0, 0.0, 0.0, 0.3, 0.0, 0.5), *near, pose(-1.0, 0.0, 0.5, 0.0, 0.4, 0.5)])
    assert central_pose(poses, length=0.2) == 2
