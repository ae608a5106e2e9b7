"""Outlines of the primitives of some hands, in few operations: `outline` with matrices.

Every part is a unit one, stretched: a cone that begins as the unit circle at height 0 and ends at height 1, or the unit
sphere. The columns of a matrix A are its stretched axes, that of the height last; a point u of the unit part then lies
at A u + p, the camera is seen from the part at -A⁻¹ p, and a surface normal n of the unit part becomes A⁻ᵀ n. The
generators are those of `torchhand.view.outlines.generators`.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import CONE_NAMES, ELLIPSOID_NAMES, PrimitiveSizes
from torchhand.hand.primitives import CONE_BONES, ELLIPSOID_BONES
from torchhand.view.outlines.contour_visibility import Quadrics
from torchhand.view.outlines.outline import OutlineTable

_CONES = len(CONE_NAMES)
_PARTS = _CONES + len(ELLIPSOID_NAMES)
_HEIGHT_LAST = (0, 2, 1)  # a primitive's own axis is its y
_NOTHING = 1e-18


@dataclass(frozen=True, kw_only=True)
class OutlineColumns:
    """Points of outlines in the camera's frame, a row for each coordinate."""

    points: Float[Tensor, "hands 3 points"]
    """Points in the camera frame, metres."""
    normals: Float[Tensor, "hands 3 points"] | None
    """Outward surface normals, not of unit length."""
    is_real: Bool[Tensor, "hands points"] | None
    """False where the part has no outline: seen along its axis, clipped away, or with the camera inside."""


class PartOutlines:
    """Outlines of one shape at the points of one table; what does not change is laid out once.

    table: part by part, with the same number of points on every cone that it has, and on every ellipsoid.
    """

    def __init__(self, sizes: PrimitiveSizes, table: OutlineTable, *, is_left: bool, is_orthographic: bool) -> None:
        turned, origin = sizes.mirrored_placement if is_left else sizes.placement
        start, length = sizes.cone_start, sizes.cone_length
        stretch = torch.cat((torch.stack((start[:, 0], length, start[:, 1]), -1), sizes.ellipsoid_axes))
        stretch = stretch[:, None, _HEIGHT_LAST]
        matrix = torch.cat((turned[..., _HEIGHT_LAST] * stretch, origin[..., None]), 2)
        corner = origin.new_tensor((0.0, 0.0, 0.0, 1.0)).expand(_PARTS, 1, 4)
        self._bone_from_part = torch.cat((matrix, corner), 1)
        self._unstretched = stretch.square().reciprocal()
        self._bones = torch.tensor(CONE_BONES + ELLIPSOID_BONES, device=origin.device)
        cones, balls = _parts_of(table.cone), _parts_of(table.ellipsoid)
        self.counts = (len(cones), len(balls))
        self._cones, self._balls = cones, balls + _CONES
        self.bones: list[int] = self._bones[torch.cat((self._cones, self._balls))].tolist()
        """Of the table's parts."""
        fraction = table.cone_fraction.to(origin).reshape(len(cones), 1, -1)
        taper = (1 - sizes.cone_end_scale)[cones, None, None]
        self._side = table.cone_side.reshape(1, len(cones), 1, -1)
        self._fraction, self._width, self._taper = fraction, 1 - taper * fraction, taper
        self._sweep = (2 * table.ellipsoid_fraction.to(origin) - 1).reshape(len(balls), -1)
        self._level = sizes.ellipsoid_level[balls]
        self._is_orthographic, self._weight = is_orthographic, 0.0 if is_orthographic else 1.0
        diagonal, self._slope, self._low, self._high = sizes.form
        self._form, self._length = diagonal[:, None, _HEIGHT_LAST] * self._unstretched, stretch[:, :, 2]

    def placed(self, cam_from_bone: Float[Tensor, "hands 20 3 4"]) -> Float[Tensor, "hands 37 3 4"]:
        """Stretched axes and place of every part, in PRIMITIVE_NAMES order."""
        return cam_from_bone.index_select(1, self._bones) @ self._bone_from_part

    def __call__(self, placed: Float[Tensor, "hands 37 3 4"], *, with_normals: bool = False) -> OutlineColumns:
        """Outlines of placed parts. with_normals: and with what is real."""
        axes = placed[..., :3]
        seen_from = axes[:, :, 2:] if self._is_orthographic else placed[..., 3:].mT @ axes
        eye = -(seen_from * self._unstretched).squeeze(2)
        cones, cone_normals, cone_is_real = self._on_cones(eye.index_select(1, self._cones))
        arcs, arc_is_real = self._on_ellipsoids(eye.index_select(1, self._balls))
        points = self._columns(placed, cones, arcs)
        if not with_normals:
            return OutlineColumns(points=points, normals=None, is_real=None)
        normals = self._columns(axes * self._unstretched, cone_normals, arcs)
        is_real = zip((cone_is_real, arc_is_real), (cones, arcs), strict=True)
        is_real = torch.cat([real.repeat_interleave(own.shape[3], 1) for real, own in is_real], 1)
        return OutlineColumns(points=points, normals=normals, is_real=is_real)

    def split(self, rows: Float[Tensor, "*batch rows points"]) -> list[Float[Tensor, "*batch parts rows each"]]:
        """Values at the table's points as values at its parts: of the cones, of the ellipsoids."""
        sizes = (self._side.shape[1] * self._side.shape[3], self._sweep.numel())
        groups = zip(rows.split(sizes, -1), self.counts, strict=True)
        return [group.unflatten(-1, (count, -1)).transpose(-2, -3) for group, count in groups]

    def quadrics(self, placed: Float[Tensor, "hands 37 3 4"]) -> Quadrics:
        """Quadrics of all parts, as `Primitives.implicit`."""
        axes, place = placed[..., :3], placed[..., 3]
        upper, axis = (axes * self._form) @ axes.mT, axes[..., 2] / self._length
        pulled, tilt = (upper @ place[..., None]).squeeze(-1), axis * self._slope[:, None]
        height = (axis * place).sum(-1)
        return Quadrics(
            upper=upper,
            edge=tilt - pulled,
            corner=((pulled - 2 * tilt) * place).sum(-1) - 1,
            axis=axis,
            low=self._low + height,
            high=self._high + height,
        )

    def _columns(self, matrix: Tensor, cones: Tensor, arcs: Tensor) -> Float[Tensor, "hands 3 points"]:
        """Points or normals of the unit parts under the matrices of all parts, and moved where these hold places."""
        columns = []
        for which, unit in ((self._cones, cones), (self._balls, arcs)):
            own = matrix.index_select(1, which)
            moved = own[..., :3] @ unit
            moved = moved + own[..., 3:] if own.shape[3] > 3 else moved
            columns.append(moved.transpose(1, 2).flatten(2))
        return torch.cat(columns, 2)

    def _on_cones(self, eye: Float[Tensor, "hands cones 3"]) -> tuple[Tensor, Tensor, Bool[Tensor, "hands cones"]]:
        """Points and normals (hands, cones, 3, each). At angle φ of the section: cos φ x + sin φ z = w - taper · y."""
        x, z, y = eye.unbind(2)
        distance = torch.addcmul(x * x, z, z).clamp_min(_NOTHING).sqrt()
        ratio = (self._weight - self._taper[:, 0, 0] * y) / distance
        limit = _limit(ratio)
        cosine = ratio.clamp(-limit, limit)
        ahead, beside = cosine / distance, (1 - cosine * cosine).sqrt() / distance
        x_ahead, z_ahead, x_beside, z_beside = x * ahead, z * ahead, x * beside, z * beside
        sides = (x_ahead + z_beside, x_ahead - z_beside, z_ahead - x_beside, z_ahead + x_beside)
        both = torch.stack(sides, 2).unflatten(2, (2, 2))  # coordinate, side
        across = both.gather(3, self._side.expand(len(eye), -1, 2, -1))
        points = torch.cat((across * self._width, self._fraction.expand(len(eye), -1, -1, -1)), 2)
        normals = torch.cat((across, self._taper.expand(len(eye), -1, -1, across.shape[3])), 2)
        return points, normals, ratio.abs() < 1

    def _on_ellipsoids(self, eye: Float[Tensor, "hands balls 3"]) -> tuple[Tensor, Bool[Tensor, "hands balls"]]:
        """Points (hands, balls, 3, each), which are their own normals: the circle u · eye = w, above the level."""
        squared = (eye * eye).sum(2)
        is_inside = squared <= self._weight
        squared = torch.where(is_inside, squared + 2, squared)  # the camera is inside: any finite outline
        shrink = self._weight / squared
        radius = (1 - shrink).clamp_min(1e-12).sqrt()
        x, z, y = (eye * squared.rsqrt()[..., None]).unbind(2)
        flatness = torch.addcmul(x * x, z, z)
        steepness = flatness.clamp_min(_NOTHING).sqrt()
        # Seen along its axis there is no highest point: any.
        across_x, across_z = x / steepness, z / steepness - y.sign() * (flatness < _NOTHING)
        reach = (self._level - shrink * eye[..., 2]) / (radius * steepness)
        limit = _limit(reach)
        half_angle = torch.where(reach <= -1, torch.pi, reach.clamp(-limit, limit).acos())
        angle = half_angle[..., None] * self._sweep
        first = torch.stack((-across_x * y, -across_z * y, steepness), 2)
        second = torch.stack((-across_z, across_x, torch.zeros_like(x)), 2)
        circle = torch.stack((shrink[..., None] * eye, radius[..., None] * first, radius[..., None] * second), 3)
        points = circle @ torch.stack((torch.ones_like(angle), angle.cos(), angle.sin()), 2)
        return points, ~is_inside & (reach < 1)


def _limit(like: Tensor) -> float:
    """The largest cosine that is used, as in `torchhand.view.outlines.generators`."""
    return 1 - max(1e-9, 8 * torch.finfo(like.dtype).eps)


def _parts_of(index: Tensor) -> Tensor:
    """The parts in the order of their points."""
    parts, counts = index.unique_consecutive(return_counts=True)
    if len(parts) != len(index.unique()) or len(counts.unique()) > 1:
        raise ValueError("table: expected equally many points on every cone, and on every ellipsoid, one after another")
    return parts
