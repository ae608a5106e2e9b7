"""All residuals of contours in one pass against each by itself; what they are at hands that are known."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.fit.contour.plain import coverage, outer_contour, robust_equations, summed, valley
from torchhand.fit.contour.correspondences import Correspondences, boundary_offset, contour_terms
from torchhand.fit.contour.matching import match_boundary
from torchhand.hand import HandPose
from torchhand.image import boundary_field, boundary_points, channel_of, point_field
from torchhand.view import VisibleContour

GROSS = torch.tensor((4.0, 3.0, 5.0), dtype=torch.float64)
VALLEY_GROSS = torch.tensor((2.5, 2.0, 3.0), dtype=torch.float64)
UNMATCHED = torch.tensor((33.0, 30.0, 36.0), dtype=torch.float64)


class Compared:
    """Three hands, a boundary of which the second matches nothing, and random weights, a third of them 0."""

    def __init__(self, bench: Any, generator: torch.Generator, *, has_valleys: bool) -> None:
        self.hands: HandPose = bench.hand.expand(3)
        self.visible: VisibleContour = bench.contours.visible(self.hands, probe_distance_px=2.0)
        self.boundary, self.field = boundary_points(bench.mask, 90), boundary_field(bench.mask, channels=8)
        self.valleys = None
        if has_valleys:
            self.valleys = point_field(100 * torch.rand(20, 2, generator=generator), 160, 120, pitch_px=0.5)
        visible = self.visible
        self.match = match_boundary(self.boundary, visible.points_px, visible.normals, visible.outer, turn_px=8.0)
        self.match[1] = -1
        count = visible.outer.shape[1]
        weight = torch.rand(3, count + self.match.shape[1], generator=generator, dtype=torch.float64)
        self.weight = torch.where(torch.rand(weight.shape, generator=generator) < 0.3, 0.0, weight)
        if not has_valleys:
            self.weight[:, :count].masked_fill_(visible.inner, 0.0)
        self.pairs = Correspondences.of(
            visible,
            self.field.channels,
            self.boundary,
            self.match,
            self.weight,
            gross_px=GROSS,
            valley_gross_px=VALLEY_GROSS,
            unmatched_px=UNMATCHED,
        )
        step = 0.03 * torch.randn(3, 36, generator=generator, dtype=torch.float64)
        self.moved = HandPose(dofs=self.hands.dofs + step * (torch.arange(36) > 2), reference=self.hands.reference)


@pytest.mark.parametrize("has_valleys", [True, False])
def test_one_pass_equals_residual_by_residual(has_valleys: bool, bench: Any, generator: torch.Generator) -> None:
    """At hands that have moved since the correspondences were frozen."""
    c = Compared(bench, generator, has_valleys=has_valleys)
    motion = bench.contours.motion(c.moved, c.visible)
    own, of_boundary = c.weight.split((c.visible.outer.shape[1], c.match.shape[1]), 1)
    on_outer = torch.where(c.visible.inner, 0.0, own)
    outer = outer_contour(motion, c.field, channel_of(c.visible.normals, 8))
    covered = coverage(motion, c.boundary, c.match, c.visible.normals, unmatched_px=UNMATCHED)
    plain = [robust_equations(outer, on_outer, GROSS), robust_equations(covered, of_boundary, GROSS)]
    if c.valleys is not None:
        plain.append(robust_equations(valley(motion, c.valleys), own - on_outer, VALLEY_GROSS))
    expected = summed(*plain)
    terms, cost = contour_terms(motion.columns_px, c.field, c.valleys, c.pairs)
    matrix, gradient = motion.equations(terms)
    torch.testing.assert_close(cost, expected.cost, atol=0, rtol=1e-12)
    scale = float(expected.matrix.abs().max())
    torch.testing.assert_close(matrix, expected.matrix, atol=1e-12 * scale, rtol=0)
    torch.testing.assert_close(gradient, expected.gradient, atol=1e-12 * scale, rtol=0)
    torch.testing.assert_close(boundary_offset(motion.columns_px, c.pairs), covered.residual, atol=1e-9, rtol=0)
    some = torch.tensor([2, 0])
    part, of_part = contour_terms(motion.columns_px[some], c.field, c.valleys, c.pairs.rows(some))
    torch.testing.assert_close(of_part, cost[some])
    torch.testing.assert_close(part.gradient, terms.gradient[some])


@pytest.mark.parametrize("has_valleys", [True, False])
def test_the_terms_are_the_derivative_of_the_cost(has_valleys: bool, bench: Any, generator: torch.Generator) -> None:
    """In the places of the points, by autograd."""
    c = Compared(bench, generator, has_valleys=has_valleys)
    places = bench.contours.points(c.moved, c.visible).clone().requires_grad_()
    terms, cost = contour_terms(places, c.field, c.valleys, c.pairs)
    [expected] = torch.autograd.grad(cost.sum(), places)
    found = (terms.gradient[:, :, None] * terms.direction).sum(1)
    torch.testing.assert_close(found.detach(), expected, atol=1e-10, rtol=0)


def test_a_batch_of_no_hands(bench: Any, generator: torch.Generator) -> None:
    c, nothing = Compared(bench, generator, has_valleys=False), torch.tensor([], dtype=torch.long)
    visible = c.visible.rows(nothing)
    match = match_boundary(c.boundary, visible.points_px, visible.normals, visible.outer, turn_px=8.0)
    assert match.shape == (0, len(c.boundary.points_px))
    _, cost = contour_terms(visible.points_px.mT, c.field, None, c.pairs.rows(nothing))
    assert cost.shape == (0,)


class Residuals:
    """Of a hand against the silhouette of the bench's hand, px: the outline on the map, the boundary on the outline."""

    def __init__(self, bench: Any, hand: HandPose) -> None:
        self.visible = bench.contours.visible(hand, probe_distance_px=2.0)
        motion = bench.contours.motion(hand, self.visible)
        field, boundary = boundary_field(bench.mask, channels=8), boundary_points(bench.mask, 200)
        self.outer_contour = outer_contour(motion, field, channel_of(self.visible.normals, 8))
        visible = self.visible
        match = match_boundary(boundary, visible.points_px, visible.normals, visible.outer, turn_px=8.0)
        self.coverage = coverage(motion, boundary, match, visible.normals, unmatched_px=50.0).residual

    @property
    def outer(self) -> Tensor:
        return self.outer_contour.residual[self.visible.outer]


def test_a_hand_on_its_own_silhouette_costs_next_to_nothing(bench: Any) -> None:
    found = Residuals(bench, bench.hand)
    assert float(found.outer.abs().mean()) < 0.45
    assert abs(float(found.outer.mean())) < 0.3
    assert float(found.coverage.abs().median()) < 0.35
    assert abs(float(found.coverage.median())) < 0.25


def test_a_finger_folded_into_the_silhouette_costs_coverage_only(bench: Any) -> None:
    """What makes one-sided costs degenerate: the map alone likes the folded finger."""
    dofs = bench.hand.dofs.clone()
    dofs[0, 19:21] += 1.5  # middle finger at both outer joints, towards the camera
    found = Residuals(bench, replace(bench.hand, dofs=dofs))
    assert float(found.coverage.abs().max()) > 6.0
    assert float(found.coverage.square().mean()) > 2 * float(found.outer.square().mean())


def test_a_step_of_gauss_and_newton_undoes_a_shift(bench: Any) -> None:
    """Across the contour the derivative of the outline is exact."""
    dofs = bench.hand.dofs.clone()
    dofs[0, :3] += torch.tensor((0.002, -0.001, 0.0), dtype=torch.float64)
    found = Residuals(bench, replace(bench.hand, dofs=dofs))
    rows = found.outer_contour.jacobian[found.visible.outer][:, :2]
    step = torch.linalg.lstsq(rows, -found.outer[:, None]).solution[:, 0]
    torch.testing.assert_close(step, torch.tensor((-0.002, 0.001)).double(), atol=3e-4, rtol=0)
