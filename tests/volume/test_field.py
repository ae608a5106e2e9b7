"""The distance field against scipy, brute force, closed forms and autograd."""

from typing import Any

import numpy as np
import pytest
import scipy.ndimage
import torch

from torchhand.volume.carving import carve
from torchhand.volume.carving_settings import CarvingSettings
from torchhand.volume.cube import RootCube
from torchhand.volume.field import HullField, distance_grid, hull_field
from torchhand.volume.octree import Octree

CUBE = RootCube(centre=(0.01, -0.02, 0.005), side=0.256)
CENTRE = torch.tensor((0.02, -0.01, 0.0), dtype=torch.float64)
RADIUS = 0.05


def ball_hull(rigs: Any, *, level: int = 6, views: int = 16, centres: Any = None) -> Octree:
    cameras = rigs.random(torch.Generator().manual_seed(5), views, width=320, height=240, focal=260.0)
    centres = CENTRE[None] if centres is None else centres
    masks = [torch.stack([rigs.ball(camera, centre, RADIUS) for centre in centres]) for camera in cameras]
    return carve(masks, cameras, CUBE, CarvingSettings(level=level))


@pytest.mark.parametrize("size", [(1, 1, 1), (20, 17, 9), (3, 40, 31)])
@pytest.mark.parametrize("fraction", [0.01, 0.4])
def test_distances_are_scipys(size: tuple[int, int, int], fraction: float, generator: torch.Generator) -> None:
    marked = torch.rand(*size, generator=generator) < fraction
    marked[-1, 0, -1] = True
    expected = np.asarray(scipy.ndimage.distance_transform_edt(~marked.numpy())).astype(np.float32)
    torch.testing.assert_close(distance_grid(marked), torch.from_numpy(expected), atol=1e-6, rtol=1e-6)
    assert bool(distance_grid(torch.zeros_like(marked)).isinf().all())


def test_distances_of_many_columns_are_scipys(generator: torch.Generator) -> None:
    """More than are worked on at once, with few marks, so that distances are long."""
    marked = torch.zeros(33, 40, 31, dtype=torch.bool)
    marked.view(-1)[torch.randint(0, marked.numel(), (12,), generator=generator)] = True
    expected = np.asarray(scipy.ndimage.distance_transform_edt(~marked.numpy())).astype(np.float32)
    torch.testing.assert_close(distance_grid(marked), torch.from_numpy(expected), atol=1e-6, rtol=1e-6)
    assert float(expected.max()) > 12
    inside = np.asarray(scipy.ndimage.distance_transform_edt(marked.numpy())).astype(np.float32)
    torch.testing.assert_close(distance_grid(~marked), torch.from_numpy(inside), atol=1e-6, rtol=1e-6)


def test_field_is_the_distance_from_the_faces_of_octants(rigs: Any) -> None:
    """Along an axis of a ball the surface lies halfway between centres."""
    octree = ball_hull(rigs)
    field = hull_field(octree, margin=0.02)
    filled, first = octree.occupancy()
    corner = torch.tensor(CUBE.corner, dtype=torch.float64)
    padded = np.pad(filled.numpy(), 5)
    depth, distance = (np.asarray(scipy.ndimage.distance_transform_edt(x)) for x in (padded, ~padded))
    expected = np.where(padded, 0.5 - depth, distance - 0.5) * octree.leaf_side
    values, _ = field.sample(_centres(expected.shape, first, corner, octree.leaf_side, 5)[None])
    assert float((values[0] - torch.from_numpy(expected).reshape(-1)).abs().max()) < 1e-7


def _centres(size: Any, first: Any, corner: torch.Tensor, side: float, border: int) -> torch.Tensor:
    cells = torch.cartesian_prod(*(torch.arange(n, dtype=torch.float64) for n in size))
    return (cells + torch.tensor(first) - border + 0.5) * side + corner


def test_middle_surface_is_the_ball(rigs: Any) -> None:
    """The outer surface is too large by half the shell; its middle is right to a part of an octant of 4 mm."""
    octree = ball_hull(rigs, views=24)
    direction = torch.randn(2000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    direction = direction / direction.norm(dim=-1, keepdim=True)
    on_ball = (CENTRE + RADIUS * direction)[None]
    outer, _ = hull_field(octree).sample(on_ball)
    middle, slope = hull_field(octree, surface="middle").sample(on_ball)
    assert float(outer.max()) < 0
    assert float(outer.mean()) < -0.003
    assert abs(float(middle.mean())) < 0.0008
    assert float(middle.std()) < 0.001
    assert float((slope * direction).sum(-1).mean()) > 0.85
    # Without BLACK octants there is a surface all the same.
    coarse = ball_hull(rigs, level=3)
    assert float(coarse.volume("inner")) == 0
    values, _ = hull_field(coarse, surface="middle").sample(torch.stack((CENTRE, CENTRE + 0.2))[None])
    assert float(values[0, 0]) < 0 < float(values[0, 1])


def test_gradient_is_that_of_autograd_and_of_differences(rigs: Any) -> None:
    field = hull_field(ball_hull(rigs, level=5), margin=0.02)
    low = field.origin[0]
    high = low + field.pitch * (torch.tensor(field.values.shape[1:]) - 1)
    generator = torch.Generator().manual_seed(1)
    points = low - 0.05 + (high - low + 0.1) * torch.rand(1, 300, 3, generator=generator, dtype=torch.float64)
    points.requires_grad_()
    value, gradient = field.sample(points)
    [by_autograd] = torch.autograd.grad(value.sum(), points)
    torch.testing.assert_close(gradient, by_autograd, atol=1e-12, rtol=1e-12)
    step = 1e-7
    steps = torch.eye(3, dtype=torch.float64) * step
    numeric = torch.stack([(field.sample(points + d)[0] - field.sample(points - d)[0]) / (2 * step) for d in steps], -1)
    close = (numeric - gradient).abs().amax(-1) < 1e-6
    assert float(close.double().mean()) > 0.99  # but for cells' and the grid's borders
    assert torch.autograd.gradcheck(lambda p: field.sample(p)[0], points[:, :10].detach().requires_grad_(), eps=1e-7)


def test_outside_the_grid_the_distance_grows_and_is_continuous(rigs: Any) -> None:
    field = hull_field(ball_hull(rigs, level=5), margin=0.01)
    start = field.origin[0, 0] + field.pitch * 3
    along = torch.linspace(-0.3, 0.02, 2001, dtype=torch.float64)
    points = torch.stack((along + start, *(torch.full_like(along, float(x)) for x in CENTRE[1:])), -1)
    value, gradient = field.sample(points[None])
    assert float(value.diff().abs().max()) < 1.5 * float(along.diff().max()) * 3**0.5
    far = points[:, 0] < field.origin[0, 0] - 1e-6
    assert bool((gradient[0, far, 0] < -0.99).all())
    true = (points - CENTRE).norm(dim=-1) - RADIUS
    assert bool((value[0, far] > true[far] - 3 * field.pitch).all())
    value, gradient = field.sample(torch.full((1, 1, 3), torch.nan, dtype=torch.float64))
    assert bool(value.isnan().all())


@pytest.mark.parametrize("batch", [(), (1,), (2, 2)])
@pytest.mark.parametrize("more", [(), (3, 5)])
def test_batches_equal_a_loop(batch: tuple[int, ...], more: tuple[int, ...], rigs: Any) -> None:
    generator = torch.Generator().manual_seed(3)
    count = int(torch.Size(batch).numel())
    centres = CENTRE + 0.02 * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    octree = ball_hull(rigs, level=5, views=3, centres=centres)
    octree = Octree(root=octree.root, batch=batch, levels=octree.levels)
    field = hull_field(octree, surface="middle")
    points = CENTRE + 0.1 * torch.randn(*batch, *more, 3, generator=generator, dtype=torch.float64)
    if not more and batch == ():
        points = points.reshape(1, 3)
    value, gradient = field.sample(points)
    assert gradient.shape == points.shape
    flat = field.values.reshape(-1, *field.values.shape[-3:])
    origin = field.origin.reshape(-1, 3)
    for frame, (some, found) in enumerate(zip(points.reshape(count, -1, 3), value.reshape(count, -1), strict=True)):
        alone = HullField(values=flat[frame], origin=origin[frame], pitch=field.pitch)
        torch.testing.assert_close(alone.sample(some)[0], found)


def test_a_frame_without_hull_is_flat_and_far(rigs: Any) -> None:
    centres = torch.stack((CENTRE, CENTRE + 2.0))
    field = hull_field(ball_hull(rigs, level=5, views=3, centres=centres))
    value, _ = field.sample(CENTRE.expand(2, 1, 3))
    assert float(value[0]) < 0
    assert float(value[1]) > 0.15
    corner_point = field.origin[1] + field.pitch
    assert float(field.sample(corner_point.expand(2, 1, 3))[1][1].abs().max()) == 0


def test_says_what_is_wrong(rigs: Any) -> None:
    octree = ball_hull(rigs, level=3, views=2)
    with pytest.raises(ValueError, match="expected 0 or more metres, got -1"):
        hull_field(octree, margin=-1.0)
    with pytest.raises(ValueError, match=r"points_world: expected the shape"):
        hull_field(octree).sample(torch.zeros(2, 5, 3))


def test_part_of_a_hull_has_its_distances_away_from_the_cut(rigs: Any) -> None:
    octree = ball_hull(rigs)
    whole, part = (
        hull_field(octree, surface="middle", margin=0.03, within=within) for within in (None, (CENTRE.tolist(), 0.03))
    )
    inside = CENTRE + 0.012 * (2 * torch.rand(200, 3, generator=torch.Generator().manual_seed(0)).double() - 1)
    cut = part.sample((CENTRE + torch.tensor(((0.045, 0.0, 0.0), (0.0, 0.0, -0.045))).double())[None])[0]
    assert bool((cut > 0.01).all())  # in the ball, and outside what is wanted
    assert part.values.numel() < 0.7 * whole.values.numel()
    assert bool((part.sample(inside[None])[0] < 0).all())
    nowhere = hull_field(octree, within=((1.0, 1.0, 1.0), 0.03))
    torch.testing.assert_close(nowhere.values, hull_field(octree).values)


def test_distances_are_exact_as_far_as_is_wanted(generator: torch.Generator) -> None:
    marked = torch.rand(40, 36, 44, generator=generator) < 1e-4
    marked[20, 18, 22] = True
    exact, rough = distance_grid(marked), distance_grid(marked, steps=6)
    near = exact <= 6
    torch.testing.assert_close(rough[near], exact[near])
    assert bool((rough >= exact).all())
    assert bool((rough > exact).any())
