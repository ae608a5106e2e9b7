"""Outlines of the hand's primitives, sampled in closed form at fixed parameters (paper 003, section 4.2; FACTS 4.3, 4.5).

The paper draws each conic from its eigendecomposition, which has no solution for the line pairs of cones and cylinders and
gives points that do not correspond between two poses. Here the contour generator is parametrised on the primitive itself:
a cone has two straight generators, an ellipsoid an arc, both found in the primitive's own frame; a fixed parameter therefore
follows its point through every sigma point, and truncation gives the end points in closed form. The points lie on the conic
C = c A - b bᵀ, which the tests hold.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import CONE_NAMES, ELLIPSOID_NAMES, Primitives


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

    @property
    def primitive(self) -> Int[Tensor, "points"]:
        """Index into PRIMITIVE_NAMES of every point."""
        return torch.cat((self.cone, self.ellipsoid + len(CONE_NAMES)))

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


def outline_table(
    points_per_generator: int, points_per_arc: int, *, dtype: torch.dtype = torch.float64, without: tuple[str, ...] = ()
) -> OutlineTable:
    """Evenly spread points on every primitive but those named in `without`; ends are left out, where neighbours overlap."""
    cones = [i for i, name in enumerate(CONE_NAMES) if name not in without]
    balls = [i for i, name in enumerate(ELLIPSOID_NAMES) if name not in without]
    along = (torch.arange(points_per_generator, dtype=dtype) + 0.5) / points_per_generator
    around = (torch.arange(points_per_arc, dtype=dtype) + 0.5) / points_per_arc
    cone_ids = torch.tensor(cones)
    return OutlineTable(
        cone=cone_ids.repeat_interleave(2 * points_per_generator),
        cone_side=torch.tensor((0, 1)).repeat_interleave(points_per_generator).repeat(len(cones)),
        cone_fraction=along.repeat(2 * len(cones)),
        ellipsoid=torch.tensor(balls).repeat_interleave(points_per_arc),
        ellipsoid_fraction=around.repeat(len(balls)),
    )


@dataclass(frozen=True, kw_only=True)
class Outline:
    """Points of the contour generators in the camera frame."""

    points_cam: Float[Tensor, "*batch points 3"]
    """Metres."""
    normals_cam: Float[Tensor, "*batch points 3"]
    """Outward surface normals, not of unit length; as a homogeneous line, the tangent l = C x of the outline there."""
    is_real: Bool[Tensor, "*batch points"]
    """False where the primitive has no outline: seen along its axis, clipped away, or with the camera inside."""


def outline(primitives_cam: Primitives, table: OutlineTable, *, is_orthographic: bool = False) -> Outline:
    """Outline points of the table for every hand of the batch; primitives in the camera frame.

    Where there is no outline the point is the nearest there is (and the gradient finite), with is_real False.
    """
    cone_points, cone_normals, cone_real = _cone_outline(primitives_cam, table, is_orthographic)
    ball_points, ball_normals, ball_real = _ellipsoid_outline(primitives_cam, table, is_orthographic)
    return Outline(
        points_cam=torch.cat((cone_points, ball_points), -2),
        normals_cam=torch.cat((cone_normals, ball_normals), -2),
        is_real=torch.cat((cone_real, ball_real), -1),
    )


def _viewpoint(rotation: Tensor, position: Tensor, scale: Tensor, is_orthographic: bool) -> Tensor:
    """The camera's centre (or viewing direction) in the primitive's frame, divided by `scale` axis by axis."""
    if is_orthographic:
        return -rotation[..., 2, :] / scale
    return -(rotation.transpose(-1, -2) @ position[..., None]).squeeze(-1) / scale


def _acos_safe(cosine: Tensor) -> Tensor:
    limit = 1 - 1e-9
    return cosine.clamp(-limit, limit).acos()


def _cone_outline(primitives: Primitives, table: OutlineTable, is_orthographic: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Generators where the tangent plane holds the camera: cos φ p_x + sin φ p_z = w - k p_y in units of the section."""
    sizes = primitives.sizes
    unit = torch.stack((sizes.cone_start[..., 0], torch.ones_like(sizes.cone_length), sizes.cone_start[..., 1]), -1)
    eye = _viewpoint(primitives.cone_rotation, primitives.cone_position, unit, is_orthographic)
    slope = (1 - sizes.cone_end_scale) / sizes.cone_length
    height = (0.0 if is_orthographic else 1.0) - slope * eye[..., 1]
    distance = (eye[..., 0] ** 2 + eye[..., 2] ** 2).clamp_min(1e-30).sqrt()
    ratio = height / distance
    spread = _acos_safe(ratio)
    middle = torch.atan2(eye[..., 2], eye[..., 0])
    angle = torch.stack((middle - spread, middle + spread), -1)  # *batch 15 2
    cosine, sine = angle.cos(), angle.sin()
    start = sizes.cone_start[..., None, :]  # *batch 15 1 2
    zero = torch.zeros_like(cosine)
    low = torch.stack((start[..., 0] * cosine, zero, start[..., 1] * sine), -1)
    scale = sizes.cone_end_scale[..., None]
    rise = torch.stack((low[..., 0] * (scale - 1), zero + sizes.cone_length[..., None], low[..., 2] * (scale - 1)), -1)
    normal = torch.stack((cosine / start[..., 0], zero + slope[..., None], sine / start[..., 1]), -1)
    turn = primitives.cone_rotation[..., None, :, :]
    low = (turn @ low[..., None]).squeeze(-1) + primitives.cone_position[..., None, :]
    rise = (turn @ rise[..., None]).squeeze(-1)
    normal = (turn @ normal[..., None]).squeeze(-1)
    flat = 2 * table.cone + table.cone_side
    low, rise, normal = (x.flatten(-3, -2).index_select(-2, flat) for x in (low, rise, normal))
    points = low + table.cone_fraction.to(low.dtype)[:, None] * rise
    return points, normal, (ratio.abs() < 1).index_select(-1, table.cone)


def _ellipsoid_outline(primitives: Primitives, table: OutlineTable, is_orthographic: bool) -> tuple[Tensor, Tensor, Tensor]:
    """On the unit sphere u the outline is the circle u·p = w, with p the camera's centre; y >= level cuts an arc of it."""
    sizes = primitives.sizes
    axes, level = sizes.ellipsoid_axes, sizes.ellipsoid_level
    eye = _viewpoint(primitives.ellipsoid_rotation, primitives.ellipsoid_position, axes, is_orthographic)
    squared = (eye * eye).sum(-1)
    weight = 0.0 if is_orthographic else 1.0
    inside = squared <= weight  # the camera is inside
    squared = torch.where(inside, squared + 2, squared)
    centre = weight * eye / squared[..., None]
    radius = (1 - weight / squared).clamp_min(1e-12).sqrt()
    towards = eye / squared.sqrt()[..., None]
    # First direction: of steepest y on the circle, so that the kept arc is centred on it.
    y_axis = torch.zeros_like(eye)
    y_axis[..., 1] = 1
    first = y_axis - towards * towards[..., 1:2]
    steepness = first.norm(dim=-1)  # 0 when seen along y
    fallback = torch.zeros_like(eye)
    fallback[..., 2] = 1
    first = torch.where((steepness > 1e-9)[..., None], first, fallback - towards * towards[..., 2:])
    first = first / first.norm(dim=-1, keepdim=True).clamp_min(1e-30)
    second = torch.linalg.cross(towards, first)
    # y of the point at angle φ: centre_y + radius · steepness · cos φ >= level
    reach = (level - centre[..., 1]) / (radius * steepness.clamp_min(1e-12))
    half_angle = _acos_safe(reach)
    half_angle = torch.where(reach <= -1, torch.full_like(half_angle, torch.pi), half_angle)
    matrix = primitives.ellipsoid_rotation * axes[..., None, :]
    offset = (matrix @ centre[..., None]).squeeze(-1) + primitives.ellipsoid_position
    along_first = (matrix @ (radius[..., None] * first)[..., None]).squeeze(-1)
    along_second = (matrix @ (radius[..., None] * second)[..., None]).squeeze(-1)
    inverse = primitives.ellipsoid_rotation / axes[..., None, :]
    normal_offset = (inverse @ centre[..., None]).squeeze(-1)
    normal_first = (inverse @ (radius[..., None] * first)[..., None]).squeeze(-1)
    normal_second = (inverse @ (radius[..., None] * second)[..., None]).squeeze(-1)
    angle = (2 * table.ellipsoid_fraction.to(eye.dtype) - 1) * half_angle.index_select(-1, table.ellipsoid)
    cosine, sine = angle.cos()[..., None], angle.sin()[..., None]

    def gather(vectors: Tensor) -> Tensor:
        return vectors.index_select(-2, table.ellipsoid)

    points = gather(offset) + cosine * gather(along_first) + sine * gather(along_second)
    normals = gather(normal_offset) + cosine * gather(normal_first) + sine * gather(normal_second)
    is_real = ~inside & (reach < 1)
    return points, normals, is_real.index_select(-1, table.ellipsoid)


def pixel_normals(
    camera: Camera, plane: Float[Tensor, "*batch points 2"], normals_cam: Float[Tensor, "*batch points 3"]
) -> Float[Tensor, "*batch points 2"]:
    """Unit outward normals in the picture at points of the normalised plane, through lens distortion.

    A tangent line l of the plane has the normal (l₁, l₂) (paper 003, section 3.1); pixels x = f(plane) turn it by J⁻ᵀ.
    """
    step = 1e-6
    shifts = torch.tensor(((step, 0.0), (0.0, step)), dtype=plane.dtype, device=plane.device)
    columns = [(camera.pixels_from_plane(plane + d) - camera.pixels_from_plane(plane - d)) / (2 * step) for d in shifts]
    (a, c), (b, d) = columns[0].unbind(-1), columns[1].unbind(-1)  # J = [[a, b], [c, d]]
    n1, n2 = normals_cam[..., 0], normals_cam[..., 1]
    turned = torch.stack((d * n1 - c * n2, a * n2 - b * n1), -1)  # det(J) J⁻ᵀ n, det > 0
    return turned / turned.norm(dim=-1, keepdim=True).clamp_min(1e-30)
