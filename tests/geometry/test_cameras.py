"""Cameras against OpenCV, and their own laws."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.geometry.cameras import (
    DISTORTION_LENGTHS,
    Camera,
    assumed_camera,
    distort,
    distortion_jacobian,
    undistort,
)
from torchhand.geometry.rotations import rotation_from_vector

COEFFICIENTS = (
    *(0.11, -0.07, 0.0021, -0.0013, 0.013),  # k1 k2 p1 p2 k3
    *(0.02, 0.01, -0.004),  # k4 k5 k6
    *(0.0011, -0.0007, 0.0009, 0.0004),  # prism
    *(0.021, -0.013),  # tilt, rad
)


def _camera(length: int, *, kind: str = "pinhole") -> Camera:
    return Camera(
        intrinsics=torch.tensor(((610.0, 1.5, 322.0), (0.0, 598.0, 237.0), (0.0, 0.0, 1.0)), dtype=torch.float64),
        rotation=rotation_from_vector(torch.tensor((0.1, -0.3, 0.2), dtype=torch.float64)),
        translation=torch.tensor((0.02, -0.05, 0.6), dtype=torch.float64),
        distortion=torch.tensor(COEFFICIENTS[:length], dtype=torch.float64),
        width=640,
        height=480,
        kind="orthographic" if kind == "orthographic" else "pinhole",
    )


def _points(generator: torch.Generator, count: int = 60) -> Tensor:
    return 0.2 * (torch.rand(count, 3, generator=generator, dtype=torch.float64) - 0.5)


@pytest.mark.parametrize("length", DISTORTION_LENGTHS)
def test_projects_like_opencv(length: int, generator: torch.Generator) -> None:
    camera, points = _camera(length), _points(generator)
    intrinsics = camera.intrinsics.numpy().copy()
    intrinsics[0, 1] = 0  # OpenCV has no skew
    camera = replace(camera, intrinsics=torch.from_numpy(intrinsics))
    rotation, _ = cv2.Rodrigues(camera.rotation.numpy())
    coefficients = np.array(COEFFICIENTS[:length]) if length else None
    expected, _ = cv2.projectPoints(points.numpy(), rotation, camera.translation.numpy(), intrinsics, coefficients)
    torch.testing.assert_close(camera.project(points), torch.from_numpy(expected[:, 0]), atol=1e-9, rtol=0)


@pytest.mark.parametrize("length", DISTORTION_LENGTHS)
def test_pixels_come_back_to_the_plane(length: int, generator: torch.Generator) -> None:
    camera = _camera(length)
    plane = camera.plane_from_cam(camera.cam_from_world(_points(generator)))
    torch.testing.assert_close(camera.plane_from_pixels(camera.pixels_from_plane(plane)), plane, atol=1e-12, rtol=0)
    if length:
        assert (distort(plane, camera.distortion) - plane).abs().max() > 1e-4, "the test needs a lens that distorts"
        torch.testing.assert_close(
            undistort(distort(plane, camera.distortion), camera.distortion), plane, atol=1e-12, rtol=0
        )


@pytest.mark.parametrize("length", DISTORTION_LENGTHS)
def test_jacobian_is_the_derivative(length: int, generator: torch.Generator) -> None:
    camera = _camera(length)
    plane = camera.plane_from_cam(camera.cam_from_world(_points(generator, 5)))
    expected = torch.stack([torch.autograd.functional.jacobian(camera.pixels_from_plane, p) for p in plane])
    torch.testing.assert_close(camera.pixel_jacobian(plane), expected, atol=1e-9, rtol=0)
    if length:
        lens = torch.stack(
            [torch.autograd.functional.jacobian(lambda p: distort(p, camera.distortion), p) for p in plane]
        )
        torch.testing.assert_close(distortion_jacobian(plane, camera.distortion), lens, atol=1e-12, rtol=0)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_a_ray_passes_through_what_its_pixel_shows(kind: str, generator: torch.Generator) -> None:
    camera = _camera(0 if kind == "orthographic" else 14, kind=kind)
    points = camera.cam_from_world(_points(generator))
    origin, direction = camera.rays(camera.project(_points(torch.Generator().manual_seed(0))))
    torch.testing.assert_close(direction[:, 2], torch.ones(len(points), dtype=torch.float64))
    torch.testing.assert_close(origin + points[:, 2:] * direction, points, atol=1e-12, rtol=0)


@pytest.mark.parametrize("length", [0, 5])
def test_projection_is_differentiable(length: int, generator: torch.Generator) -> None:
    camera = _camera(length)
    points = _points(generator, 3).requires_grad_()
    assert torch.autograd.gradcheck(camera.project, (points,))
    pixels = camera.project(points).detach().requires_grad_()
    assert torch.autograd.gradcheck(camera.plane_from_pixels, (pixels,))


def test_orthographic_forgets_depth(generator: torch.Generator) -> None:
    camera = _camera(0, kind="orthographic")
    away = camera.rotation[2]  # the viewing direction in the world
    points = _points(generator)
    torch.testing.assert_close(camera.project(points + 0.3 * away), camera.project(points), atol=1e-10, rtol=0)


@pytest.mark.parametrize("scale", [0.5, 0.37, 2.0])
def test_resized_sees_what_resampling_shows(scale: float) -> None:
    """The centre of a block of pixels becomes the centre of the pixel made of it."""
    camera = _camera(5)
    small = camera.resized(scale)
    assert (small.width, small.height) == (round(640 * scale), round(480 * scale))
    corners = torch.tensor(((-0.5, -0.5), (639.5, 479.5), (100.0, 50.0)), dtype=torch.float64)
    plane = camera.plane_from_pixels(corners)
    torch.testing.assert_close(small.pixels_from_plane(plane), (corners + 0.5) * scale - 0.5, atol=1e-9, rtol=0)


def test_assumed_camera_spans_its_field_of_view() -> None:
    camera = assumed_camera(640, 480, horizontal_fov_deg=55.0)
    assert camera.is_assumed
    edges = torch.tensor(((-0.5, 239.5), (639.5, 239.5)), dtype=torch.float64)
    plane = camera.plane_from_pixels(edges)
    assert math.degrees(2 * math.atan(float(plane[1, 0]))) == pytest.approx(55.0, abs=1e-9)
    torch.testing.assert_close(plane[0], -plane[1], atol=1e-12, rtol=0)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_of_points_equal_a_loop(batch: tuple[int, ...], generator: torch.Generator) -> None:
    camera = _camera(14)
    points = 0.2 * torch.rand(*batch, 4, 3, generator=generator, dtype=torch.float64)
    expected = torch.stack([camera.project(p) for p in points.reshape(-1, 4, 3)]).reshape(*batch, 4, 2)
    torch.testing.assert_close(camera.project(points), expected, atol=1e-12, rtol=0)


def test_a_batch_of_cameras_equals_a_loop(generator: torch.Generator) -> None:
    one, other = _camera(5), replace(_camera(5), translation=torch.tensor((0.1, 0.0, 0.9), dtype=torch.float64))
    names = ("intrinsics", "rotation", "translation", "distortion")
    both = replace(one, **{name: torch.stack((getattr(one, name), getattr(other, name))) for name in names})
    points = _points(generator, 7)
    expected = torch.stack((one.project(points), other.project(points)))
    torch.testing.assert_close(both.project(points.expand(2, 7, 3)), expected, atol=1e-9, rtol=0)


def test_what_a_camera_refuses() -> None:
    camera = _camera(4)
    with pytest.raises(ValueError, match=r"distortion: expected .* coefficients, got 3"):
        replace(camera, distortion=torch.ones(3, dtype=torch.float64))
    with pytest.raises(ValueError, match="distortion: an orthographic camera has none"):
        replace(camera, kind="orthographic")
    with pytest.raises(ValueError, match="horizontal_fov_deg: expected 1 to 170, got 0"):
        assumed_camera(640, 480, horizontal_fov_deg=0.0)


def test_to_moves_every_tensor() -> None:
    moved = _camera(5).to(dtype=torch.float32)
    assert {moved.intrinsics.dtype, moved.rotation.dtype, moved.translation.dtype, moved.distortion.dtype} == {
        torch.float32
    }
