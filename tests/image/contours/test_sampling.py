"""Bilinear reading: exact on planes, the two paths agree, borders."""

import cv2
import pytest
import torch

from torchhand.image.contours.sampling import is_inside, sample_bilinear, sample_bilinear_torch


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_plane_is_read_exactly(generator: torch.Generator, dtype: torch.dtype) -> None:
    height, width = 11, 17
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    image = torch.stack([2.0 * x - 3.0 * y + 1.0, x * y + 0.0 * x]).to(dtype)
    points = torch.rand(200, 2, generator=generator, dtype=torch.float64) * torch.tensor([width - 1.0, height - 1.0])
    values = sample_bilinear(image, points.to(dtype))
    truth = torch.stack([2.0 * points[:, 0] - 3.0 * points[:, 1] + 1.0, points[:, 0] * points[:, 1]])
    assert torch.allclose(values.double(), truth, atol=2e-4)


def test_opencv_path_equals_torch_path_inside_and_outside(generator: torch.Generator) -> None:
    image = torch.rand(3, 23, 31, generator=generator)
    points = torch.rand(2, 40, 2, generator=generator) * torch.tensor([50.0, 40.0]) - 8.0
    # OpenCV before version 5 rounds places to 1/32 px.
    tolerance = 1e-5 if int(cv2.__version__.split(".")[0]) >= 5 else 1.0 / 32.0
    assert (sample_bilinear(image, points) - sample_bilinear_torch(image, points)).abs().max() < tolerance
    inside = is_inside(points, 31, 23)
    assert 0 < int(inside.sum()) < inside.numel()


def test_points_that_are_known_to_lie_inside_are_read_alike(generator: torch.Generator) -> None:
    image = torch.rand(2, 23, 31, generator=generator)
    points = torch.rand(5, 40, 2, generator=generator) * torch.tensor([30.0, 22.0])
    assert torch.equal(sample_bilinear(image, points, all_inside=True), sample_bilinear(image, points))


def test_batch_shapes_equal_a_loop(generator: torch.Generator) -> None:
    image = torch.rand(1, 20, 20, generator=generator)
    points = torch.rand(2, 3, 2, generator=generator) * 19.0
    whole = sample_bilinear(image, points)
    assert whole.shape == (1, 2, 3)
    for i in range(2):
        for j in range(3):
            assert torch.allclose(sample_bilinear(image, points[i, j]), whole[:, i, j], atol=1e-6)


def test_gradient_in_points_and_picture(generator: torch.Generator) -> None:
    image = torch.rand(2, 6, 7, generator=generator, dtype=torch.float64, requires_grad=True)
    points = (torch.rand(4, 2, generator=generator, dtype=torch.float64) * 4.0 + 0.3).requires_grad_()
    assert torch.autograd.gradcheck(sample_bilinear, (image, points))


def test_inside_ends_at_the_outer_pixel_centres() -> None:
    points = torch.tensor([[0.0, 0.0], [9.0, 4.0], [9.01, 4.0], [-0.01, 0.0], [float("nan"), 1.0]])
    assert is_inside(points, 10, 5).tolist() == [True, True, False, False, False]


@pytest.mark.parametrize("shape", [(40_000, 2), (2, 33_000, 2), (33_000, 3, 2)])
def test_any_number_of_points_is_read(shape: tuple[int, ...]) -> None:
    """A contour may have more points than OpenCV reads at once, along either axis."""
    generator = torch.Generator().manual_seed(0)
    picture = torch.rand((1, 20, 30), generator=generator)
    points = 18.0 * torch.rand(shape, generator=generator)
    assert torch.allclose(sample_bilinear(picture, points), sample_bilinear_torch(picture, points), rtol=0, atol=1e-5)
