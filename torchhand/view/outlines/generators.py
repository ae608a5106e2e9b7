"""Contour generators of the primitives in closed form: where the surface's tangent plane holds the camera.

All arrays have the batch last. A cone has two straight generators, an ellipsoid an arc; each is found in the
primitive's own frame, so that no conic has to be decomposed and a fixed parameter follows its point from pose to pose.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchhand.geometry import batch_last, compose
from torchhand.hand import CONE_NAMES, Primitives

_CONES = len(CONE_NAMES)


@dataclass(frozen=True, kw_only=True)
class ConeGenerators:
    """Two straight generators per cone: low + fraction · rise."""

    low: Tensor
    """Lower ends (15, 2, 3, n), metres."""
    rise: Tensor
    """Vectors from the lower to the upper ends (15, 2, 3, n), metres."""
    normal: Tensor | None
    """Outward normals (15, 2, 3, n), the same all along a generator."""
    is_real: Tensor
    """Whether a cone has generators that the camera sees (15, n)."""

    def of_hand(self, index: int) -> "ConeGenerators":
        """The part of one hand of the batch, with n = 1."""
        low, rise, is_real = (x[..., index : index + 1] for x in (self.low, self.rise, self.is_real))
        normal = None if self.normal is None else self.normal[..., index : index + 1]
        return ConeGenerators(low=low, rise=rise, normal=normal, is_real=is_real)


@dataclass(frozen=True, kw_only=True)
class EllipsoidArcs:
    """One arc per ellipsoid: centre + cos φ · first + sin φ · second, |φ| <= half_angle."""

    curve: Tensor
    """Curve (22, 3, 3, n) in columns centre, first, second; metres."""
    normal: Tensor | None
    """Outward normal (22, 3, 3, n) in the same three parts as the curve."""
    half_angle: Tensor
    """Half of the angle that the arc spans (22, n)."""
    is_real: Tensor
    """Whether an ellipsoid has an arc that the camera sees (22, n)."""
    is_outside: Tensor
    """Whether the camera is outside the ellipsoid (22, n)."""

    def of_hand(self, index: int) -> "EllipsoidArcs":
        """The part of one hand of the batch, with n = 1."""
        one = slice(index, index + 1)
        return EllipsoidArcs(
            curve=self.curve[..., one],
            normal=None if self.normal is None else self.normal[..., one],
            half_angle=self.half_angle[..., one],
            is_real=self.is_real[..., one],
            is_outside=self.is_outside[..., one],
        )

    def whole(self) -> "EllipsoidArcs":
        """The full ellipses, of whole ellipsoids instead of the kept parts."""
        return replace(self, half_angle=torch.full_like(self.half_angle, torch.pi), is_real=self.is_outside)


def generators(
    primitives_cam: Primitives, *, is_orthographic: bool, with_normals: bool
) -> tuple[ConeGenerators, EllipsoidArcs]:
    """Contour generators of all primitives, given in the camera frame."""
    batch = primitives_cam.position.shape[:-2]
    rotation, position = batch_last(primitives_cam.rotation, 3, batch), batch_last(primitives_cam.position, 2, batch)
    # The camera's centre, or the direction towards it, in the primitives' frames.
    eye = -rotation[:, 2] if is_orthographic else -(rotation * position[:, :, None]).sum(1)
    weight = 0.0 if is_orthographic else 1.0
    s = primitives_cam.sizes
    start, scale, length = (
        batch_last(x, own, batch) for x, own in ((s.cone_start, 2), (s.cone_end_scale, 1), (s.cone_length, 1))
    )
    axes, level = batch_last(s.ellipsoid_axes, 2, batch), batch_last(s.ellipsoid_level, 1, batch)
    cones = _cones(rotation[:_CONES], position[:_CONES], eye[:_CONES], weight, start, scale, length, with_normals)
    arcs = _arcs(rotation[_CONES:], position[_CONES:], eye[_CONES:], weight, axes, level, with_normals)
    return cones, arcs


def cone_sections(primitives_cam: Primitives) -> tuple[Tensor, Tensor]:
    """The ellipse across the lower end of every cone, in the parts of an arc (15, 3, 3, n), and its change up to the
    upper end; metres."""
    batch, s = primitives_cam.position.shape[:-2], primitives_cam.sizes
    rotation = batch_last(primitives_cam.rotation, 3, batch)[:_CONES]
    position = batch_last(primitives_cam.position, 2, batch)[:_CONES]
    start, scale, length = (
        batch_last(x, own, batch) for x, own in ((s.cone_start, 2), (s.cone_end_scale, 1), (s.cone_length, 1))
    )
    x_axis, y_axis, z_axis = rotation.transpose(1, 2).unbind(1)
    radii = torch.stack((x_axis * start[:, :1], z_axis * start[:, 1:]), 2)
    section = torch.cat((position[:, :, None], radii), 2)
    growth = torch.cat(((y_axis * length[:, None])[:, :, None], radii * (scale - 1)[:, None, None]), 2)
    return section, growth


def _limit(like: Tensor) -> float:
    """The largest cosine that is used: a little below 1, where the derivative of the angle is still finite."""
    return 1 - max(1e-9, 8 * torch.finfo(like.dtype).eps)


def _cones(
    rotation: Tensor,
    position: Tensor,
    eye: Tensor,
    weight: float,
    start: Tensor,
    scale: Tensor,
    length: Tensor,
    with_normals: bool,
) -> ConeGenerators:
    """Generators of cones. At angle φ of the section: cos φ p_x + sin φ p_z = w - k p_y, p the camera in units of the
    section at the start."""
    across = eye[:, ::2] / start
    slope = (1 - scale) / length
    distance = (across * across).sum(1).clamp_min(1e-18).sqrt()
    ratio = (weight - slope * eye[:, 1]) / distance
    limit = _limit(ratio)
    cosine = ratio.clamp(-limit, limit)
    sine = (1 - cosine * cosine).sqrt()
    # The direction to the camera, turned both ways by the angle of that cosine.
    towards = across / distance[:, None]
    beside = towards.flip(1) * torch.stack((sine, -sine), 1)
    ahead = towards * cosine[:, None]
    direction = torch.stack((ahead + beside, ahead - beside), 1)[:, :, :, None]  # 15, sides, (cos φ, sin φ), 1, n
    columns = rotation.transpose(1, 2)[:, None]  # 15, 1, column, 3, n
    x_axis, y_axis, z_axis = columns.unbind(2)
    scaled = direction * start[:, None, :, None]
    lateral = torch.addcmul(x_axis * scaled[:, :, 0], z_axis, scaled[:, :, 1])
    low = lateral + position[:, None]
    rise = torch.addcmul(y_axis * length[:, None, None], lateral, (scale - 1)[:, None, None])
    normal = None
    if with_normals:
        steep = direction / start[:, None, :, None]
        normal = torch.addcmul(x_axis * steep[:, :, 0], z_axis, steep[:, :, 1]) + y_axis * slope[:, None, None]
    return ConeGenerators(low=low, rise=rise, normal=normal, is_real=ratio.abs() < 1)


def _arcs(
    rotation: Tensor, position: Tensor, eye: Tensor, weight: float, axes: Tensor, level: Tensor, with_normals: bool
) -> EllipsoidArcs:
    """Arcs of ellipsoids. On the unit sphere u the outline is the circle u·p = w, p the camera's centre; y >= level
    cuts an arc of it.

    φ = 0 is the circle's highest point (largest y), so the kept arc is centred on it. Seen along y there is none: any.
    """
    eye = eye / axes
    squared = (eye * eye).sum(1)
    is_inside = squared <= weight
    squared = torch.where(is_inside, squared + 2, squared)  # the camera is inside: any finite outline
    distance = squared.sqrt()
    radius = (1 - weight / squared).clamp_min(1e-12).sqrt()
    x, y, z = (eye / distance[:, None]).unbind(1)
    flatness = x * x + z * z
    is_along = flatness < 1e-18
    steepness = torch.where(is_along, torch.ones_like(flatness), flatness).sqrt()
    across_x = torch.where(is_along, torch.zeros_like(x), x / steepness)
    across_z = torch.where(is_along, -y.sign(), z / steepness)
    steepness = torch.where(is_along, torch.zeros_like(steepness), steepness)
    first = torch.stack((-across_x * y, steepness, -across_z * y), 1)
    second = torch.stack((-across_z, torch.zeros_like(x), across_x), 1)
    centre = (weight / squared)[:, None] * eye
    circle = torch.stack((centre, radius[:, None] * first, radius[:, None] * second), 2)  # 22, component, part, n
    reach = (level - centre[:, 1]) / (radius * steepness.clamp_min(1e-12))
    limit = _limit(reach)
    half_angle = torch.where(reach <= -1, torch.full_like(reach, torch.pi), reach.clamp(-limit, limit).acos())
    curve = compose(rotation, circle * axes[:, :, None])
    curve = torch.cat((curve[:, :, :1] + position[:, :, None], curve[:, :, 1:]), 2)
    normal = compose(rotation, circle / axes[:, :, None]) if with_normals else None
    is_outside = ~is_inside
    return EllipsoidArcs(
        curve=curve,
        normal=normal,
        half_angle=half_angle,
        is_real=is_outside & (reach < 1),
        is_outside=is_outside,
    )
