"""The truncated quadrics of a hand as closed meshes, differentiable in where they are and how large."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import kept
from torchhand.hand import CONE_NAMES, ELLIPSOID_NAMES, Primitives
from torchhand.precision import own_precision

_SPOKES = 24
_RINGS = 9  # of an ellipsoid, from where it is cut off to its top
_SWELLING = math.sqrt(2 * math.pi / _SPOKES / math.sin(2 * math.pi / _SPOKES))
"""A polygon with the area of the circle has corners that lie beyond it by this factor."""


@own_precision
def primitive_mesh(primitives: Primitives) -> tuple[Float[Tensor, "*batch vertices 3"], Int[Tensor, "faces 3"]]:
    """Vertices, metres, in the frame of the primitives, and faces of 37 closed surfaces, counter-clockwise from
    outside.

    Sections are polygons of 24 corners with the areas of the ellipses; a mesh reaches at most 0.6 % of its primitive's
    radius beyond it.
    """
    sizes, like = primitives.sizes, primitives.position
    angle = torch.arange(_SPOKES, dtype=like.dtype, device=like.device) * (2 * math.pi / _SPOKES)
    x, z = _SWELLING * angle.cos(), _SWELLING * angle.sin()
    start = sizes.cone_start[..., None, None, :]
    scale = torch.stack((torch.ones_like(sizes.cone_end_scale), sizes.cone_end_scale), -1)[..., None]
    height = torch.stack((torch.zeros_like(sizes.cone_length), sizes.cone_length), -1)
    cones = _closed(start[..., 0] * scale * x, height, start[..., 1] * scale * z)
    level = sizes.ellipsoid_level.clamp(-1, 1).asin()[..., None]
    share = torch.linspace(0, 1, _RINGS, dtype=like.dtype, device=like.device)
    latitude = level + (0.5 * math.pi - level) * share
    a, b, c = sizes.ellipsoid_axes[..., None].unbind(-2)
    ring = latitude.cos()
    balls = _closed((a * ring)[..., None] * x, b * latitude.sin(), (c * ring)[..., None] * z)
    parts = []
    for points, rotation, position in (
        (cones, primitives.cone_rotation, primitives.cone_position),
        (balls, primitives.ellipsoid_rotation, primitives.ellipsoid_position),
    ):
        parts.append((points @ rotation.mT + position[..., None, :]).flatten(-3, -2))
    return torch.cat(parts, -2), _faces(like.device)


def _closed(
    x: Float[Tensor, "*batch rings spokes"], y: Float[Tensor, "*batch rings"], z: Float[Tensor, "*batch rings spokes"]
) -> Float[Tensor, "*batch points 3"]:
    """The points of the rings, then the middles of the first and of the last one."""
    points = torch.stack((x, y[..., None].expand_as(x), z), -1)
    middles = y[..., (0, -1)]
    middles = torch.stack((torch.zeros_like(middles), middles, torch.zeros_like(middles)), -1)
    return torch.cat((points.flatten(-3, -2), middles), -2)


@kept(8)
def _faces(device: torch.device) -> Int[Tensor, "faces 3"]:
    """Faces of all cones, then of all ellipsoids."""
    found, before = [], 0
    for count, rings in ((len(CONE_NAMES), 2), (len(ELLIPSOID_NAMES), _RINGS)):
        own, points = _faces_of_rings(rings), rings * _SPOKES + 2
        found += [own + before + points * index for index in range(count)]
        before += points * count
    return torch.cat(found).to(device)


def _faces_of_rings(rings: int) -> Int[Tensor, "faces 3"]:
    ring, spoke = torch.meshgrid(torch.arange(rings - 1), torch.arange(_SPOKES), indexing="ij")
    here, beside = ring * _SPOKES + spoke, ring * _SPOKES + (spoke + 1) % _SPOKES
    sides = (
        torch.stack((here, here + _SPOKES, beside), -1),
        torch.stack((beside, here + _SPOKES, beside + _SPOKES), -1),
    )
    low, high = torch.full((_SPOKES,), rings * _SPOKES), torch.full((_SPOKES,), rings * _SPOKES + 1)
    caps = (
        torch.stack((low, here[0], beside[0]), -1),
        torch.stack((high, beside[-1] + _SPOKES, here[-1] + _SPOKES), -1),
    )
    return torch.cat((*(side.flatten(0, 1) for side in sides), *caps))
