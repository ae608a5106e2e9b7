"""Moments of masks against closed forms."""

import math

import pytest
import torch

from torchhand.image.fingers.moments import mask_moments


def ellipse(angle: float, long: float, short: float, centre: tuple[float, float]) -> torch.Tensor:
    y, x = torch.meshgrid(torch.arange(160.0), torch.arange(200.0), indexing="ij")
    dx, dy = x - centre[0], y - centre[1]
    u = math.cos(angle) * dx + math.sin(angle) * dy
    v = -math.sin(angle) * dx + math.cos(angle) * dy
    return (u / long) ** 2 + (v / short) ** 2 <= 1.0


@pytest.mark.parametrize("angle", [-1.2, -0.4, 0.0, 0.7, 1.5])
def test_ellipse(angle: float) -> None:
    moments = mask_moments(ellipse(angle, 60.0, 22.0, (101.3, 77.6)))
    assert float(moments.area) == pytest.approx(math.pi * 60.0 * 22.0, rel=0.005)
    assert moments.centroid_px.tolist() == pytest.approx([101.3, 77.6], abs=0.1)
    lengths = 2.0 * torch.linalg.eigvalsh(moments.covariance_px2).sqrt()
    assert lengths.tolist() == pytest.approx([22.0, 60.0], rel=0.01)
    assert float(moments.axis_angle) == pytest.approx(angle, abs=0.005)
    direction = moments.axis
    assert direction.tolist() == pytest.approx([math.cos(angle), math.sin(angle)], abs=0.005)


def test_equals_the_covariance_of_the_pixels(generator: torch.Generator) -> None:
    mask = torch.rand(30, 40, generator=generator) < 0.2
    y, x = mask.nonzero(as_tuple=True)
    points = torch.stack([x, y]).double()
    moments = mask_moments(mask)
    assert torch.allclose(moments.centroid_px.double(), points.mean(dim=1), atol=1e-4)
    assert torch.allclose(moments.covariance_px2.double(), torch.cov(points, correction=0), atol=1e-3)


def test_batch_shapes_equal_a_loop(generator: torch.Generator) -> None:
    masks = torch.rand(2, 3, 20, 30, generator=generator)
    whole = mask_moments(masks)
    for i in range(2):
        for j in range(3):
            part = mask_moments(masks[i, j])
            assert torch.allclose(part.centroid_px, whole.centroid_px[i, j], atol=1e-5)
            assert torch.allclose(part.covariance_px2, whole.covariance_px2[i, j], atol=1e-3)
            assert torch.allclose(part.axis_angle, whole.axis_angle[i, j], atol=1e-4)


def test_gradient_of_a_soft_mask(generator: torch.Generator) -> None:
    mask = (torch.rand(4, 5, generator=generator, dtype=torch.float64) + 0.1).requires_grad_()

    def all_moments(weights: torch.Tensor) -> tuple[torch.Tensor, ...]:
        moments = mask_moments(weights)
        return moments.area, moments.centroid_px, moments.covariance_px2, moments.axis_angle

    assert torch.autograd.gradcheck(all_moments, (mask,))


def test_empty_mask_has_no_centre() -> None:
    moments = mask_moments(torch.zeros(5, 6, dtype=torch.bool))
    assert float(moments.area) == 0.0
    assert moments.centroid_px.isnan().all()
