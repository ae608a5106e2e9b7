"""Morphology, smoothing and pieces: plain definitions, and OpenCV's way and torch's way to the same result."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.image.contours import distance_map
from torchhand.image.operations import suits_opencv
from torchhand.image.operations.morphology import (
    binomial_blur,
    bounding_box,
    closed,
    count_pieces,
    dilate,
    disc_kernel,
    erode,
    gaussian_blur,
    gradient,
    label_pieces,
    numbered_pieces,
    opened,
    square_kernel,
)
from torchhand.image.operations.reduction import enlarged_mask, reduced, reduced_mask
from torchhand.image.segmentation import clean, components, fill_holes, largest_component, luminance, touching

KERNELS = [disc_kernel(1), disc_kernel(4), square_kernel(1), square_kernel(3)]
OPERATIONS = [dilate, erode, opened, closed]


@contextmanager
def torch_alone() -> Iterator[None]:
    """No tensor suits OpenCV, as on another device, and no call of OpenCV is let through."""

    def refused(*_: Any, **__: Any) -> None:
        raise AssertionError("OpenCV was called")

    names = ("dilate", "erode", "GaussianBlur", "Sobel", "boundingRect", "resize", "cvtColor", "distanceTransform")
    labels = ("connectedComponentsWithAlgorithm", "connectedComponentsWithStatsWithAlgorithm")
    with pytest.MonkeyPatch.context() as patch:
        for module in [module for name, module in sys.modules.items() if name.startswith("torchhand.image.")]:
            if hasattr(module, "suits_opencv"):
                patch.setattr(module, "suits_opencv", lambda *_: False)
        for name in (*names, *labels):
            patch.setattr(cv2, name, refused)
        yield


def masks(generator: torch.Generator) -> list[Tensor]:
    """Noise from sparse to dense, blobs, a spiral, nothing and everything."""
    noise = [torch.rand(37, 53, generator=generator) < fraction for fraction in (0.05, 0.3, 0.5, 0.6, 0.9)]
    blobs = gaussian_blur(torch.rand(60, 80, generator=generator), 3.0)
    spiral = torch.zeros(41, 41, dtype=torch.bool)
    for ring in range(0, 20, 2):
        spiral[ring, ring : 41 - ring] = spiral[ring : 41 - ring, 40 - ring] = True
        spiral[40 - ring, ring : 41 - ring] = spiral[ring + 2 : 41 - ring, ring] = True
        spiral[ring + 2, ring : ring + 3] = True
    nothing = torch.zeros(9, 7, dtype=torch.bool)
    return [*noise, blobs > blobs.median(), spiral, nothing, ~nothing, torch.ones(1, 1, dtype=torch.bool)]


def same(function: Callable[..., Any], *inputs: Any, tolerance: float = 0.0) -> None:
    """Both ways give the same."""
    expected = function(*inputs)
    with torch_alone():
        got = function(*inputs)
    if not isinstance(expected, Tensor):
        assert got == expected
        return
    assert got.dtype == expected.dtype
    assert got.shape == expected.shape
    torch.testing.assert_close(got, expected, rtol=0, atol=tolerance)


def slow(mask: Tensor, kernel: Tensor, *, is_any: bool) -> Tensor:
    """Dilation or erosion by a loop over pixels; neighbours beyond the border take no part."""
    reach = kernel.shape[0] // 2
    out = torch.zeros_like(mask)
    for y in range(mask.shape[0]):
        for x in range(mask.shape[1]):
            seen = [
                mask[y + dy, x + dx]
                for dy in range(-reach, reach + 1)
                for dx in range(-reach, reach + 1)
                if kernel[dy + reach, dx + reach] and 0 <= y + dy < mask.shape[0] and 0 <= x + dx < mask.shape[1]
            ]
            out[y, x] = torch.stack(seen).any() if is_any else torch.stack(seen).all()
    return out


def test_a_disc_holds_the_neighbours_within_its_radius() -> None:
    for radius in range(40):
        kernel = disc_kernel(radius)
        assert torch.equal(kernel, kernel.flip(0))
        assert torch.equal(kernel, kernel.flip(1))
        y, x = (kernel.nonzero() - radius).unbind(-1)
        assert float((x**2 + y**2).float().sqrt().max()) < radius + 0.5
        assert len(x) == pytest.approx(np.pi * radius**2, rel=0.05, abs=2 * radius + 2)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: f"{k.shape[0]}_{int(k.sum())}")
def test_masks_grow_and_shrink_as_a_slow_loop_says_in_both_ways(kernel: Tensor, generator: torch.Generator) -> None:
    mask = torch.rand(14, 19, generator=generator) < 0.3
    for operation, is_any in ((dilate, True), (erode, False)):
        assert torch.equal(operation(mask, kernel), slow(mask, kernel, is_any=is_any))
    for one in masks(generator):
        for operation in OPERATIONS:
            same(operation, one, kernel)
    for operation in OPERATIONS:
        batch = torch.rand(2, 3, 14, 19, generator=generator) < 0.4
        same(operation, batch, kernel)
        assert torch.equal(operation(batch, kernel)[1, 2], operation(batch[1, 2], kernel))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: f"{k.shape[0]}_{int(k.sum())}")
def test_numbers_grow_and_shrink_alike_in_both_ways(
    kernel: Tensor, dtype: torch.dtype, generator: torch.Generator
) -> None:
    for shape in ((14, 19), (2, 14, 19), (3, 3)):
        plane = torch.randn(*shape, generator=generator, dtype=dtype)
        for operation in OPERATIONS:
            same(operation, plane, kernel)
    level = 0.3
    with torch_alone():  # a threshold and a dilation may change places
        assert torch.equal(dilate(plane, kernel) > level, dilate(plane > level, kernel))


def test_gradients_of_numbers_flow_to_the_pixel_that_is_the_largest() -> None:
    plane = torch.tensor([[0.0, 1.0, 2.0], [5.0, 3.0, 4.0]], dtype=torch.float64, requires_grad=True)
    (found,) = torch.autograd.grad(dilate(plane, square_kernel(1)).sum(), plane)
    assert found.tolist() == [[0, 0, 0], [4, 0, 2]]
    (found,) = torch.autograd.grad(erode(plane, square_kernel(1))[0, 0], plane)
    assert found.tolist() == [[1, 0, 0], [0, 0, 0]]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("shape", [(31, 43), (2, 3, 9, 12), (2, 5), (1, 1)])
def test_smoothing_and_slopes_are_the_same_in_both_ways(
    shape: tuple[int, ...], dtype: torch.dtype, generator: torch.Generator
) -> None:
    plane = torch.rand(*shape, generator=generator, dtype=dtype)
    tolerance = 2e-6 if dtype == torch.float32 else 1e-7  # OpenCV's kernels may be rounded
    for sigma in (0.6, 1.0, 1.5, 4.0):
        same(gaussian_blur, plane, sigma, tolerance=tolerance)
    same(binomial_blur, plane, tolerance=tolerance)
    same(gradient, plane, tolerance=tolerance)


def test_smoothing_and_slopes_are_differentiable(generator: torch.Generator) -> None:
    plane = torch.rand(5, 6, generator=generator, dtype=torch.float64, requires_grad=True)
    for function in (lambda x: gaussian_blur(x, 0.8), binomial_blur, gradient):
        assert torch.autograd.gradcheck(function, (plane,))


def test_smoothing_keeps_a_ramp_and_slopes_are_those_of_it() -> None:
    y, x = torch.meshgrid(torch.arange(20.0), torch.arange(30.0), indexing="ij")
    ramp, inner = 2 * x - 3 * y, (..., slice(5, -5), slice(5, -5))
    for smooth in (gaussian_blur(ramp, 1.0), binomial_blur(ramp)):
        torch.testing.assert_close(smooth[inner], ramp[inner], rtol=0, atol=1e-4)
    slopes = gradient(ramp)
    torch.testing.assert_close(slopes[0][inner], torch.full((10, 20), 2.0), rtol=0, atol=1e-5)
    torch.testing.assert_close(slopes[1][inner], torch.full((10, 20), -3.0), rtol=0, atol=1e-5)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_pieces_are_numbered_measured_and_counted_alike_in_both_ways(
    connectivity: int, generator: torch.Generator
) -> None:
    for mask in masks(generator):
        expected = label_pieces(mask, connectivity)
        with torch_alone():
            got = label_pieces(mask, connectivity)
            assert count_pieces(mask, connectivity) == len(expected.areas)
        assert torch.equal(got.labels, expected.labels)
        assert torch.equal(got.areas, expected.areas)
        assert torch.equal(got.boxes, expected.boxes)
        torch.testing.assert_close(got.centroids, expected.centroids, rtol=0, atol=1e-9)
        assert count_pieces(mask, connectivity) == len(expected.areas)
        labels, count = numbered_pieces(mask, connectivity)
        assert torch.equal(labels, expected.labels)
        assert count == len(expected.areas)
        same(bounding_box, mask)
    with pytest.raises(ValueError, match="connectivity: expected 4 or 8, got 6"):
        label_pieces(mask, 6)


def test_what_is_made_of_them_is_the_same_in_both_ways(generator: torch.Generator) -> None:
    every = masks(generator)
    for mask, other in zip(every, reversed(every), strict=True):
        for function in (components, largest_component, fill_holes, clean):
            same(function, mask)
        same(fill_holes, mask, 3)
        same(touching, mask, other[:1, :1].expand_as(mask))
        same(touching, mask, torch.rand(mask.shape, generator=generator) < 0.02)
        same(distance_map, mask, tolerance=1e-3)  # OpenCV's precise transform is rounded


@pytest.mark.parametrize("size", [(48, 64), (24, 32), (23, 29), (1, 1), (47, 64), (48, 5)])
def test_reduction_is_the_mean_over_areas_in_both_ways(size: tuple[int, int], generator: torch.Generator) -> None:
    plane = torch.rand(48, 64, generator=generator)
    same(reduced, plane, *size, tolerance=1e-3 / min(48 / size[0], 64 / size[1]))  # OpenCV leaves slivers out
    assert float(reduced(plane, *size).mean()) == pytest.approx(float(plane.mean()), abs=5e-3)
    mask = gaussian_blur(plane, 2.0) > 0.5
    same(reduced_mask, mask, *size)


def test_a_mask_is_enlarged_alike_by_both(monkeypatch: pytest.MonkeyPatch) -> None:
    mask = torch.zeros(12, 9, dtype=torch.bool)
    mask[3:8, 2:7] = True
    found = enlarged_mask(mask, 48, 36)
    assert int(found[12:32, 8:28].sum()) == int(found.sum()) == 20 * 20 - 4  # without its corners
    monkeypatch.setattr("torchhand.image.operations.reduction.suits_opencv", lambda plane: False)
    assert torch.equal(enlarged_mask(mask, 48, 36), found)


def test_a_reduced_mask_is_set_where_half_of_it_is() -> None:
    mask = torch.zeros(4, 8, dtype=torch.bool)
    mask[:2, :2] = mask[0, 2:4] = mask[0, 4] = mask[2:, 6] = True
    for _ in range(2):
        assert reduced_mask(mask, 2, 4).int().tolist() == [[1, 1, 0, 0], [0, 0, 0, 1]]
    with torch_alone():
        assert reduced_mask(mask, 2, 4).int().tolist() == [[1, 1, 0, 0], [0, 0, 0, 1]]
    with pytest.raises(ValueError, match=r"size: expected 1 to \(4, 8\), got \(5, 8\)"):
        reduced_mask(mask, 5, 8)


def test_luminance_is_the_same_in_both_ways(generator: torch.Generator) -> None:
    image = torch.randint(0, 256, (200, 300, 3), generator=generator, dtype=torch.uint8)
    same(luminance, image)
    weights = torch.tensor([0.299, 0.587, 0.114])
    torch.testing.assert_close(
        luminance(image).float(), image.float() @ weights, rtol=0, atol=0.505
    )  # weights of 15 bits


def test_the_rule_takes_a_gradient_and_another_device_from_opencv() -> None:
    plain = torch.zeros(2, 2)
    assert suits_opencv(plain, plain)
    assert not suits_opencv(plain, plain.clone().requires_grad_())
    assert not suits_opencv(plain.to("meta"))
    with torch.no_grad():
        assert suits_opencv(plain.clone().requires_grad_())
