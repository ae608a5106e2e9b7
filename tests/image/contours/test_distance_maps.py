"""Distance transforms against brute force and scipy; the differentiable one against finite differences."""

import cv2
import numpy as np
import pytest
import scipy.ndimage
import torch
from torch import Tensor

from torchhand.image.contours.distance_maps import distance_map, distance_map_torch


def sparse(generator: torch.Generator, *size: int, fraction: float = 0.02) -> Tensor:
    return torch.rand(*size, generator=generator) < fraction


def brute_force(mask: Tensor) -> Tensor:
    y, x = mask.nonzero(as_tuple=True)
    rows, columns = torch.meshgrid(*(torch.arange(n) for n in mask.shape), indexing="ij")
    squared = (rows[..., None] - y).square() + (columns[..., None] - x).square()
    return squared.amin(-1).double().sqrt()


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (37, 1), (31, 53)])
def test_both_exact_maps_are_the_nearest_distance(size: tuple[int, int], generator: torch.Generator) -> None:
    mask = sparse(generator, *size)
    mask[0, -1] = True
    expected = brute_force(mask)
    torch.testing.assert_close(distance_map(mask).double(), expected, atol=1e-3, rtol=0)  # OpenCV's own accuracy
    torch.testing.assert_close(distance_map_torch(mask).double(), expected, atol=1e-5, rtol=0)


def test_agrees_with_scipy_on_a_large_picture(generator: torch.Generator) -> None:
    mask = sparse(generator, 240, 320, fraction=0.0005)
    exact = np.asarray(scipy.ndimage.distance_transform_edt(~mask.numpy()))
    expected = torch.from_numpy(exact.astype(np.float32))
    torch.testing.assert_close(distance_map(mask), expected, atol=1e-3, rtol=0)
    torch.testing.assert_close(distance_map_torch(mask), expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize("threads", [2, 3])
def test_opencv_gives_the_same_bits_with_any_number_of_threads(threads: int, generator: torch.Generator) -> None:
    mask = torch.rand(100, 90, generator=generator) < 0.002
    before, maps = cv2.getNumThreads(), []
    try:
        for count in (1, threads):
            cv2.setNumThreads(count)
            maps.append(distance_map(mask))
    finally:
        cv2.setNumThreads(before)
    assert torch.equal(*maps)
    squares = maps[0].double().square()
    assert torch.equal(maps[0], squares.round().sqrt().float())


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], generator: torch.Generator) -> None:
    masks = sparse(generator, *batch, 20, 30)
    for whole in (distance_map(masks), distance_map_torch(masks)):
        assert whole.shape == masks.shape
        for one, mask in zip(whole.reshape(-1, 20, 30), masks.reshape(-1, 20, 30), strict=True):
            torch.testing.assert_close(one, distance_map(mask), atol=1e-3, rtol=0)


def test_without_any_mark_everything_is_infinitely_far() -> None:
    empty = torch.zeros(2, 5, 6, dtype=torch.bool)
    empty[1, 2, 3] = True
    for found in (distance_map(empty), distance_map_torch(empty)):
        assert bool(found[0].isinf().all())
        assert float(found[1].max()) < 6


def test_where_everything_is_marked_nothing_is_far() -> None:
    marked = torch.ones(2, 5, 7, dtype=torch.bool)
    assert torch.equal(distance_map(marked), torch.zeros(2, 5, 7))
    assert torch.equal(distance_map_torch(marked), torch.zeros(2, 5, 7))


def test_kornia_map_is_right_along_rows_and_short_across(generator: torch.Generator) -> None:
    mask = torch.zeros(41, 41)
    mask[20, 20] = 1
    found = distance_map(mask, "kornia", kernel_size=3)
    exact = distance_map(mask.bool())
    assert float((found - exact)[20].abs().max()) < 1.0
    assert float((exact - found)[0, 0]) > 3.0  # of 28 px: no Euclidean distance


def test_gradient_of_the_kornia_map(generator: torch.Generator) -> None:
    mask = 0.9 * torch.rand(1, 6, 7, generator=generator, dtype=torch.float64) + 0.05
    mask.requires_grad_()
    assert torch.autograd.gradcheck(lambda m: distance_map(m, "kornia", kernel_size=3), mask, atol=1e-4)


def test_says_what_is_wrong() -> None:
    mask = torch.zeros(4, 4, dtype=torch.bool)
    with pytest.raises(ValueError, match=r"expected torch\.bool"):
        distance_map(mask.float())
    with pytest.raises(ValueError, match="floating point"):
        distance_map(mask, "kornia")
    with pytest.raises(ValueError, match="odd number of 3 or more, got 4"):
        distance_map(mask.float(), "kornia", kernel_size=4)
