"""Residuals of contours: derivatives against autograd, values at hands that are known, what degenerate fits cost."""

from typing import Any, cast

import torch
from torch import Tensor

from torchhand.fit.contour.coverage import coverage_residual, match_boundary
from torchhand.fit.contour.outer_contour import outer_contour_residual
from torchhand.fit.contour.valley import valley_residual
from torchhand.image import Boundary, boundary_field, boundary_points, channel_of, point_field

ATOL = 1e-9


def slope(residual: Any, straight: Any) -> Tensor:
    """Jacobian of a residual in the free parameters by autograd, hand by hand."""

    def of(free: Tensor) -> Tensor:
        return residual(type(straight)(straight.start, straight.slopes, free))[0]

    whole = cast(Tensor, torch.autograd.functional.jacobian(of, straight.free))
    return torch.stack([whole[i, :, i] for i in range(len(straight.free))])


def test_outer_contour_derivative(bench: Any, generator: torch.Generator) -> None:
    straight = bench.straight(generator)
    field = boundary_field(bench.mask, channels=8)
    channel = torch.randint(8, straight.start.shape[:2], generator=generator)
    _, jacobian = outer_contour_residual(straight, field, channel)
    expected = slope(lambda motion: outer_contour_residual(motion, field, channel), straight)
    torch.testing.assert_close(jacobian, expected, atol=ATOL, rtol=0)


def test_valley_derivative(bench: Any, generator: torch.Generator) -> None:
    straight = bench.straight(generator)
    field = point_field(100 * torch.rand(20, 2, generator=generator), 160, 120, pitch_px=0.5)
    distance, jacobian = valley_residual(straight, field)
    assert bool((distance >= 0).all())
    expected = slope(lambda motion: valley_residual(motion, field), straight)
    torch.testing.assert_close(jacobian, expected, atol=ATOL, rtol=0)


def test_coverage_derivative(bench: Any, generator: torch.Generator) -> None:
    straight = bench.straight(generator)
    boundary = boundary_points(bench.mask, 50)
    normals = torch.nn.functional.normalize(torch.randn(3, 40, 2, generator=generator).double(), dim=-1)
    match = torch.randint(40, (3, len(boundary.points_px)), generator=generator)
    match[1, :7] = -1

    def residual(motion: Any) -> tuple[Tensor, Tensor]:
        return coverage_residual(motion, boundary, match, normals, unmatched_px=33.0)

    value, jacobian = residual(straight)
    torch.testing.assert_close(jacobian, slope(residual, straight), atol=ATOL, rtol=0)
    assert bool((value[1, :7] == 33.0).all())
    assert not bool(jacobian[1, :7].any())


def test_matching_is_the_nearest_in_place_and_direction(generator: torch.Generator) -> None:
    """Against all distances; the side of a finger goes to the same side."""
    points = 100 * torch.rand(2, 60, 2, generator=generator, dtype=torch.float64)
    normals = torch.nn.functional.normalize(torch.randn(2, 60, 2, generator=generator).double(), dim=-1)
    own = torch.nn.functional.normalize(torch.randn(30, 2, generator=generator).double(), dim=-1)
    boundary = Boundary(points_px=100 * torch.rand(30, 2, generator=generator).double(), normals=own)
    usable = torch.rand(2, 60, generator=generator) < 0.5
    found = match_boundary(boundary, points, normals, usable, turn_px=15.0)
    apart = (boundary.points_px[:, None] - points[:, None]).square().sum(-1)
    apart = apart + 225 * (own[:, None] - normals[:, None]).square().sum(-1)
    apart = torch.where(usable[:, None], apart, torch.inf)
    assert torch.equal(found, apart.argmin(-1))
    usable[1] = False
    assert bool((match_boundary(boundary, points, normals, usable, turn_px=15.0)[1] == -1).all())


def test_a_hand_on_its_own_silhouette_costs_next_to_nothing(bench: Any) -> None:
    """Both ways: the outline on the map, and the boundary on the outline."""
    look = bench.contours.look(bench.pose, bench.reference, beyond_px=2.0)
    motion = bench.contours.motion(bench.pose, bench.reference, look)
    field, boundary = boundary_field(bench.mask, channels=8), boundary_points(bench.mask, 200)
    distance, _ = outer_contour_residual(motion, field, channel_of(look.normals, 8))
    assert float(distance[look.outer].abs().mean()) < 0.45
    assert abs(float(distance[look.outer].mean())) < 0.3
    match = match_boundary(boundary, look.points_px, look.normals, look.outer, turn_px=8.0)
    offset, _ = coverage_residual(motion, boundary, match, look.normals, unmatched_px=50.0)
    assert float(offset.abs().median()) < 0.35
    assert abs(float(offset.median())) < 0.25


def test_a_finger_folded_into_the_silhouette_costs_coverage_only(bench: Any) -> None:
    """What makes one-sided costs degenerate: the map alone likes the folded finger."""
    folded = bench.pose.clone()
    folded[0, 19:21] += 1.5  # middle finger at both outer joints, towards the camera
    look = bench.contours.look(folded, bench.reference, beyond_px=2.0)
    motion = bench.contours.motion(folded, bench.reference, look)
    field, boundary = boundary_field(bench.mask, channels=8), boundary_points(bench.mask, 200)
    distance, _ = outer_contour_residual(motion, field, channel_of(look.normals, 8))
    match = match_boundary(boundary, look.points_px, look.normals, look.outer, turn_px=8.0)
    offset, _ = coverage_residual(motion, boundary, match, look.normals, unmatched_px=50.0)
    assert float(offset.abs().max()) > 6.0
    assert float(offset.square().mean()) > 2 * float(distance[look.outer].square().mean())


def test_derivative_of_the_model_s_own_outline(bench: Any) -> None:
    """With the hand's true motion: across the contour it is exact, so a step of Gauss-Newton undoes a shift."""
    moved = bench.pose.clone()
    moved[0, :3] += torch.tensor((0.002, -0.001, 0.0), dtype=torch.float64)
    look = bench.contours.look(moved, bench.reference, beyond_px=2.0)
    motion = bench.contours.motion(moved, bench.reference, look)
    field = boundary_field(bench.mask, channels=8)
    distance, jacobian = outer_contour_residual(motion, field, channel_of(look.normals, 8))
    rows = look.outer[0]
    step = torch.linalg.lstsq(jacobian[0, rows][:, :2], -distance[0, rows, None]).solution[:, 0]
    torch.testing.assert_close(step, torch.tensor((-0.002, 0.001)).double(), atol=3e-4, rtol=0)
