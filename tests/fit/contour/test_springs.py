"""All contour residuals in one pass against each by itself through `weighted_equations`."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit import summed, weighted_equations
from torchhand.fit.contour.coverage import coverage_residual, match_boundary
from torchhand.fit.contour.outer_contour import outer_contour_residual
from torchhand.fit.contour.springs import PictureTerms, boundary_offset, contour_springs
from torchhand.fit.contour.valley import valley_residual
from torchhand.hand import PoseSpace
from torchhand.image import Boundary, DistanceField, boundary_field, boundary_points, channel_of, point_field
from torchhand.numerics import NormalEquations, RobustLoss
from torchhand.view import ContourLook, ContourMotion

ROBUST, VALLEY_ROBUST, UNMATCHED = 4.0, 2.5, 33.0


def plainly(
    motion: ContourMotion,
    look: ContourLook,
    picture: tuple[DistanceField, DistanceField | None, Boundary],
    match: Tensor,
    weight: Tensor,
) -> NormalEquations:
    """The specification: residual by residual, with a row of a Jacobian for each."""
    field, valleys, boundary = picture
    robust, of_valleys = (RobustLoss(kind="geman_mcclure", scale=scale) for scale in (ROBUST, VALLEY_ROBUST))
    own, of_boundary = weight.split((look.outer.shape[1], match.shape[1]), 1)
    on_outer = torch.where(look.inner, 0.0, own)
    outer = outer_contour_residual(motion, field, channel_of(look.normals, field.channels))
    covered = coverage_residual(motion, boundary, match, look.normals, unmatched_px=UNMATCHED)
    terms = [weighted_equations(*outer, on_outer, robust), weighted_equations(*covered, of_boundary, robust)]
    if valleys is not None:
        terms.append(weighted_equations(*valley_residual(motion, valleys), own - on_outer, of_valleys))
    return summed(terms)


@pytest.mark.parametrize("has_valleys", [True, False])
def test_one_pass_equals_residual_by_residual(has_valleys: bool, bench: Any, generator: torch.Generator) -> None:
    """At hands that have moved since they were looked at; one of them matches nothing."""
    space: PoseSpace = bench.space
    free = space.free(bench.pose).repeat(3, 1)
    reference = bench.reference.repeat(3, 1, 1)
    look = bench.contours.look(space.dof(free), reference, beyond_px=2.0)
    boundary = boundary_points(bench.mask, 90)
    match = match_boundary(boundary, look.points_px, look.normals, look.outer, turn_px=8.0)
    match[1] = -1
    field = boundary_field(bench.mask, channels=8)
    valleys = point_field(100 * torch.rand(20, 2, generator=generator), 160, 120, pitch_px=0.5)
    valleys = valleys if has_valleys else None
    weight = torch.rand(3, look.outer.shape[1] + match.shape[1], generator=generator, dtype=torch.float64)
    weight = torch.where(torch.rand(weight.shape, generator=generator) < 0.3, 0.0, weight)
    if not has_valleys:
        weight[:, : look.outer.shape[1]].masked_fill_(look.inner, 0.0)
    terms = PictureTerms.of(
        look,
        field.channels,
        boundary,
        match,
        weight,
        robust_px=ROBUST,
        valley_robust_px=VALLEY_ROBUST,
        unmatched_px=UNMATCHED,
    )
    moved = space.dof(free + 0.03 * torch.randn(free.shape, generator=generator, dtype=torch.float64))
    motion = bench.contours.motion(moved, reference, look)
    expected = plainly(motion, look, (field, valleys, boundary), match, weight)
    springs, cost = contour_springs(motion.columns_px, field, valleys, terms)
    matrix, gradient = motion.equations(springs)
    torch.testing.assert_close(cost, expected.cost, atol=0, rtol=1e-12)
    scale = float(expected.matrix.abs().max())
    torch.testing.assert_close(space.basis.T @ matrix @ space.basis, expected.matrix, atol=1e-12 * scale, rtol=0)
    torch.testing.assert_close(gradient @ space.basis, expected.gradient, atol=1e-12 * scale, rtol=0)
    offset, _ = coverage_residual(motion, boundary, match, look.normals, unmatched_px=UNMATCHED)
    torch.testing.assert_close(boundary_offset(motion.columns_px, terms), offset, atol=1e-9, rtol=0)
    some = torch.tensor([2, 0])
    part, of_part = contour_springs(motion.columns_px[some], field, valleys, terms.rows(some))
    torch.testing.assert_close(of_part, cost[some])
    torch.testing.assert_close(part.pull, springs.pull[some])


def test_a_batch_of_no_hands(bench: Any) -> None:
    look = bench.contours.look(bench.pose, bench.reference, beyond_px=2.0).rows(torch.tensor([], dtype=torch.long))
    boundary, field = boundary_points(bench.mask, 30), boundary_field(bench.mask, channels=8)
    match = match_boundary(boundary, look.points_px, look.normals, look.outer, turn_px=8.0)
    assert match.shape == (0, len(boundary.points_px))
    terms = PictureTerms.of(
        look,
        field.channels,
        boundary,
        match,
        torch.zeros(0, look.outer.shape[1] + match.shape[1], dtype=torch.float64),
        robust_px=ROBUST,
        valley_robust_px=VALLEY_ROBUST,
        unmatched_px=UNMATCHED,
    )
    _, cost = contour_springs(look.points_px.mT, field, None, terms)
    assert cost.shape == (0,)
