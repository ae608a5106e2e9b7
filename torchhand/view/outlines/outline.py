"""Outlines of the hand's primitives, sampled in closed form at fixed parameters (Stenger et al. 2001,
4.2).

The paper draws each conic from its eigendecomposition, which has no solution for the line pairs of cones and cylinders
and gives points that do not correspond between two poses. Here the contour generator is parametrised on the primitive
itself: a cone has two straight generators, an ellipsoid an arc, both found in the primitive's own frame; a fixed
parameter therefore follows its point from pose to pose, and truncation gives the end points in closed form. Sigma
points are compared along normals, by the farthest place of the same section (`farthest_along`). The points lie on the
conic C = c A - b bᵀ, which the tests hold.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import Camera, batch_first
from torchhand.hand import CONE_NAMES, ELLIPSOID_NAMES, Primitives
from torchhand.precision import own_precision
from torchhand.view.outlines.generators import ConeGenerators, EllipsoidArcs, generators


@dataclass(frozen=True, kw_only=True)
class OutlineTable:
    """Which outline points to compute: first those on cones, then those on ellipsoids."""

    cone: Int[Tensor, "cone_points"]
    """Index into CONE_NAMES."""
    cone_side: Int[Tensor, "cone_points"]
    """0 or 1: which of the two generators."""
    cone_fraction: Float[Tensor, "cone_points"]
    """0 at the cone's beginning, 1 at its end."""
    ellipsoid: Int[Tensor, "ellipsoid_points"]
    """Index into ELLIPSOID_NAMES."""
    ellipsoid_fraction: Float[Tensor, "ellipsoid_points"]
    """0 and 1 are the two ends of the visible arc (or the same point of a whole ellipse)."""

    @property
    def size(self) -> int:
        return len(self.cone) + len(self.ellipsoid)

    @cached_property
    def primitive(self) -> Int[Tensor, "points"]:
        """Index into PRIMITIVE_NAMES of every point."""
        with torch.inference_mode(False):  # kept for callers in any mode
            return torch.cat((self.cone, self.ellipsoid + len(CONE_NAMES)))

    @cached_property
    def generator(self) -> Int[Tensor, "cone_points"]:
        """Index of every cone point's generator, two per cone."""
        with torch.inference_mode(False):  # kept for callers in any mode
            return 2 * self.cone + self.cone_side

    @cached_property
    def neighbours(self) -> Int[Tensor, "2 points"]:
        """The points before and after every point on the same curve; the point itself at the ends."""
        with torch.inference_mode(False):
            curve = torch.cat((self.generator, self.ellipsoid + 2 * len(CONE_NAMES)))
            place, follows = torch.arange(self.size, device=curve.device), curve[1:] == curve[:-1]
            before, after = place.clone(), place.clone()
            before[1:] -= follows.long()
            after[:-1] += follows.long()
            return torch.stack((before, after))

    @cached_property
    def sweep(self) -> Float[Tensor, "ellipsoid_points 1"]:
        """Where on its arc every ellipsoid's point is, -1 and 1 being the ends."""
        with torch.inference_mode(False):
            return (2 * self.ellipsoid_fraction - 1)[:, None]

    def select(self, keep: Bool[Tensor, "points"]) -> "OutlineTable":
        """The points where `keep` is true, in the same order."""
        on_cones, on_balls = keep[: len(self.cone)], keep[len(self.cone) :]
        return OutlineTable(
            cone=self.cone[on_cones],
            cone_side=self.cone_side[on_cones],
            cone_fraction=self.cone_fraction[on_cones],
            ellipsoid=self.ellipsoid[on_balls],
            ellipsoid_fraction=self.ellipsoid_fraction[on_balls],
        )

    def thinned(self, factor: int) -> "OutlineTable":
        """Evenly spread points, one in place of so many, of a table that `outline_table` made; at least two on every
        curve that has them, each of which stands for a length."""
        cones, balls = self.cone.unique_consecutive(), self.ellipsoid.unique_consecutive()
        on_each = len(self.cone) // max(1, 2 * len(cones)), len(self.ellipsoid) // max(1, len(balls))
        return _even_table(
            cones,
            balls,
            *(max(min(2, own), own // factor) for own in on_each),
            dtype=self.cone_fraction.dtype,
        )


def outline_table(
    points_per_generator: int, points_per_arc: int, *, dtype: torch.dtype = torch.float64, without: tuple[str, ...] = ()
) -> OutlineTable:
    """Evenly spread points on every primitive but those named in `without`; ends are left out, where neighbours
    overlap."""
    cones = torch.tensor([i for i, name in enumerate(CONE_NAMES) if name not in without])
    balls = torch.tensor([i for i, name in enumerate(ELLIPSOID_NAMES) if name not in without])
    return _even_table(cones, balls, points_per_generator, points_per_arc, dtype=dtype)


def _even_table(
    cones: Int[Tensor, "cones"], balls: Int[Tensor, "balls"], per_generator: int, per_arc: int, *, dtype: torch.dtype
) -> OutlineTable:
    """So many points on each of two generators of the cones, and on the arcs of the ellipsoids."""
    along = (torch.arange(per_generator, dtype=dtype, device=cones.device) + 0.5) / per_generator
    around = (torch.arange(per_arc, dtype=dtype, device=cones.device) + 0.5) / per_arc
    sides = torch.tensor((0, 1), device=cones.device)
    return OutlineTable(
        cone=cones.repeat_interleave(2 * per_generator),
        cone_side=sides.repeat_interleave(per_generator).repeat(len(cones)),
        cone_fraction=along.repeat(2 * len(cones)),
        ellipsoid=balls.repeat_interleave(per_arc),
        ellipsoid_fraction=around.repeat(len(balls)),
    )


def lengths_along(columns_px: Float[Tensor, "hands 2 points"], table: OutlineTable) -> Float[Tensor, "hands points"]:
    """Length of outline that each point of the table stands for, px: half the way from the point before it on its curve
    to the one after, whole at an end. Zero for a curve's only point and where a neighbour is not finite."""
    before, after = table.neighbours
    way = (columns_px.index_select(2, after) - columns_px.index_select(2, before)).square().sum(1).sqrt()
    return torch.where(way.isfinite(), way, 0.0) / (after - before).clamp_min(1)


@dataclass(frozen=True, kw_only=True)
class Outline:
    """Points of the contour generators in the camera frame."""

    points_cam: Float[Tensor, "*batch points 3"]
    """Points in the camera frame, metres."""
    normals_cam: Float[Tensor, "*batch points 3"]
    """Outward surface normals, not of unit length; as a homogeneous line, the tangent l = C x of the outline there."""
    is_real: Bool[Tensor, "*batch points"]
    """False where the primitive has no outline: seen along its axis, clipped away, or with the camera inside."""


@own_precision
def outline(primitives_cam: Primitives, table: OutlineTable, *, is_orthographic: bool = False) -> Outline:
    """Outline points of the table for every hand of the batch; primitives in the camera frame.

    Where there is no outline the point is the nearest there is (and the gradient finite), with is_real False.
    """
    cones, arcs = generators(primitives_cam, is_orthographic=is_orthographic, with_normals=True)
    return outline_of(cones, arcs, table, primitives_cam.position.shape[:-2])


def outline_of(cones: ConeGenerators, arcs: EllipsoidArcs, table: OutlineTable, batch: tuple[int, ...]) -> Outline:
    """`outline` where the generators, with normals, are known."""
    points = sample_generators(cones, arcs, table)
    assert cones.normal is not None
    assert arcs.normal is not None
    on_cones = cones.normal.flatten(0, 1).index_select(0, table.generator)
    normals = torch.cat((on_cones, _along(arcs.normal, arcs.half_angle, table)))
    real = (cones.is_real.index_select(0, table.cone), arcs.is_real.index_select(0, table.ellipsoid))
    return Outline(
        points_cam=batch_first(points, batch),
        normals_cam=batch_first(normals, batch),
        is_real=batch_first(torch.cat(real), batch),
    )


def outline_points(
    primitives_cam: Primitives, table: OutlineTable, *, is_orthographic: bool = False
) -> Float[Tensor, "*batch points 3"]:
    """Only the points of `outline`, in half the time."""
    cones, arcs = generators(primitives_cam, is_orthographic=is_orthographic, with_normals=False)
    return batch_first(sample_generators(cones, arcs, table), primitives_cam.position.shape[:-2])


def sample_generators(cones: ConeGenerators, arcs: EllipsoidArcs, table: OutlineTable) -> Tensor:
    """The table's points of the generators: (points, 3, n)."""
    low, rise = (x.flatten(0, 1).index_select(0, table.generator) for x in (cones.low, cones.rise))
    on_cones = torch.addcmul(low, rise, table.cone_fraction.to(low.dtype)[:, None, None])
    return torch.cat((on_cones, _along(arcs.curve, arcs.half_angle, table)))


def farthest_along(
    sections: tuple[Tensor, Tensor],
    arcs: EllipsoidArcs,
    table: OutlineTable,
    normals: Float[Tensor, "points 2"],
    *,
    is_orthographic: bool,
) -> Tensor:
    """The point of each table point's curve that lies farthest along a normal of the normalised plane: (points, 3, n).

    The curve is the cone's section at the point's fraction, or the ellipsoid's outline. At the hand that the normals
    belong to it is the table's own point. At others a fixed place on the curve moves round the bone as the bone turns,
    the faster the more it points at the camera, although the outline hardly changes. sections: `cone_sections`.
    """
    section, growth = (x.index_select(0, table.cone) for x in sections)
    on_cones = torch.addcmul(section, growth, table.cone_fraction.to(section.dtype)[:, None, None, None])
    curve = torch.cat((on_cones, arcs.curve.index_select(0, table.ellipsoid)))
    x, y, depth = curve.unbind(1)  # points, (centre, first, second), n
    across = torch.addcmul(normals[:, :1, None] * x, normals[:, 1:, None], y)
    centre, first, second = across.unbind(1)
    if is_orthographic:
        cosine, sine, rest = second, -first, torch.zeros_like(first)
    else:
        # Along the curve the derivative of across / depth is 0 where cos φ cosine + sin φ sine + rest is.
        deep, deep_first, deep_second = depth.unbind(1)
        cosine = second * deep - centre * deep_second
        sine = centre * deep_first - first * deep
        rest = second * deep_first - first * deep_second
    unit = torch.addcmul(cosine * cosine, sine, sine).clamp_min(torch.finfo(curve.dtype).tiny).rsqrt()
    cosine, sine, ahead = cosine * unit, sine * unit, (-rest * unit).clamp(-1, 1)
    aside = (1 - ahead * ahead).sqrt()
    middle, first, second = curve.unbind(2)
    on_first, on_second = cosine * ahead - sine * aside, sine * ahead + cosine * aside
    return torch.addcmul(torch.addcmul(middle, first, on_first[:, None]), second, on_second[:, None])


def _along(curve: Tensor, half_angle: Tensor, table: OutlineTable) -> Tensor:
    """The table's points of arcs given by their centre and two radii: (points, 3, n)."""
    angle = half_angle.index_select(0, table.ellipsoid) * table.sweep.to(curve.dtype)
    centre, first, second = curve.index_select(0, table.ellipsoid).unbind(2)
    return torch.addcmul(torch.addcmul(centre, first, angle.cos()[:, None]), second, angle.sin()[:, None])


@own_precision
def pixel_normals(
    camera: Camera, plane: Float[Tensor, "*batch points 2"], normals_cam: Float[Tensor, "*batch points 3"]
) -> Float[Tensor, "*batch points 2"]:
    """Unit outward normals in the picture at points of the normalised plane, through lens distortion.

    A tangent line l of the plane has the normal (l₁, l₂) (Stenger et al. 2001, 3.1); pixels x = f(plane) turn it by
    J⁻ᵀ.
    """
    (a, b), (c, d) = (row.unbind(-1) for row in camera.pixel_jacobian(plane).unbind(-2))
    n1, n2 = normals_cam[..., 0], normals_cam[..., 1]
    turned = torch.stack((d * n1 - c * n2, a * n2 - b * n1), -1)  # det(J) J⁻ᵀ n, det > 0
    return turned / turned.norm(dim=-1, keepdim=True).clamp_min(1e-30)
