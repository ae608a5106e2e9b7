"""Quadric surfaces, their clipping planes, their images and their meeting with rays (Stenger et al. 2001, 3.1 and 4.2).

A quadric is a symmetric 4 x 4 matrix Q; a point X is inside where Xᵀ Q X < 0. A truncated quadric also has a matrix Π
of a pair of planes and keeps the points with Xᵀ Π X >= 0.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.precision import own_precision


@own_precision
def ellipsoid(semi_axes: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 4 4"]:
    """Ellipsoid about the origin with the given semi-axes along x, y, z (metres)."""
    inverse = semi_axes.square().reciprocal()
    return torch.diag_embed(torch.cat((inverse, -torch.ones_like(inverse[..., :1])), -1))


@own_precision
def cone(
    start: Float[Tensor, "*batch 2"], end_scale: Float[Tensor, "*batch"], length: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch 4 4"]:
    """Elliptic cone about the y axis; a cylinder where `end_scale` is 1 (the limit is smooth).

    The section at y = 0 has semi-axes `start` along x and z, the section at y = `length` has `end_scale` times these:
    (x/a)² + (z/c)² = (1 - k y)² with k = (1 - end_scale) / length.
    """
    slope = (1 - end_scale) / length
    inverse = start.square().reciprocal()
    zero = torch.zeros_like(slope)
    rows = (
        (inverse[..., 0], zero, zero, zero),
        (zero, -slope * slope, zero, slope),
        (zero, zero, inverse[..., 1], zero),
        (zero, slope, zero, -torch.ones_like(slope)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


@own_precision
def plane_pair(first: Float[Tensor, "*batch 4"], second: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Π = π π'ᵀ + π' πᵀ; Xᵀ Π X = 2 (π·X)(π'·X) is positive where both planes agree in sign."""
    product = first[..., :, None] * second[..., None, :]
    return product + product.transpose(-1, -2)


@own_precision
def slab(low: Float[Tensor, "*batch"], high: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 4 4"]:
    """Clipping pair that keeps low <= y <= high."""
    zero, one = torch.zeros_like(low), torch.ones_like(low)
    return plane_pair(torch.stack((zero, one, zero, -low), -1), torch.stack((zero, -one, zero, high), -1))


@own_precision
def half_space(level: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 4 4"]:
    """Clipping pair (one plane and the plane at infinity) that keeps y >= level."""
    zero, one = torch.zeros_like(level), torch.ones_like(level)
    infinity = torch.stack((zero, zero, zero, one), -1)
    return plane_pair(torch.stack((zero, one, zero, -level), -1), infinity)


@own_precision
def moved(
    quadric: Float[Tensor, "*#batch 4 4"],
    rotation: Float[Tensor, "*#batch 3 3"],
    translation: Float[Tensor, "*#batch 3"],
) -> Float[Tensor, "*_ 4 4"]:
    """The quadric (or plane pair) after X_new = rotation X + translation: T⁻ᵀ Q T⁻¹, in closed form."""
    upper, edge, corner = quadric[..., :3, :3], quadric[..., :3, 3:], quadric[..., 3:, 3:]
    new_upper = rotation @ upper @ rotation.transpose(-1, -2)
    shift = translation[..., None]
    turned = rotation @ edge
    new_edge = turned - new_upper @ shift
    shift_t = shift.transpose(-1, -2)
    new_corner = corner - 2 * shift_t @ turned + shift_t @ new_upper @ shift
    return torch.cat(
        (torch.cat((new_upper, new_edge), -1), torch.cat((new_edge.transpose(-1, -2), new_corner), -1)), -2
    )


@own_precision
def conic_of_quadric(quadric: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Outline of a quadric seen by the normalised camera [I | 0].

    C = c A - b bᵀ for Q = [[A, b], [bᵀ, c]] (Stenger et al. 2001, 3.1). A ray x meets the quadric where xᵀ C x <= 0.
    With c < 0 the camera is inside and there is no outline; c near 0 is unstable. Holds for cones and cylinders too,
    which the dual form does not.
    """
    edge = quadric[..., :3, 3]
    return quadric[..., 3:, 3:] * quadric[..., :3, :3] - edge[..., :, None] * edge[..., None, :]


@own_precision
def orthographic_conic_of_quadric(quadric: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Outline of a quadric seen along z: C = Q₃₃ Q[i, i] - q qᵀ with i = (x, y, w), q = Q[i, z]."""
    keep = torch.tensor((0, 1, 3), device=quadric.device)
    rest = quadric.index_select(-1, keep).index_select(-2, keep)
    edge = quadric[..., 2].index_select(-1, keep)
    return quadric[..., 2, 2, None, None] * rest - edge[..., :, None] * edge[..., None, :]


@own_precision
def evaluate(quadric: Float[Tensor, "*#batch 4 4"], points: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*_"]:
    """Xᵀ Q X of the homogeneous points (x, y, z, 1); both arguments broadcast."""
    linear = (quadric[..., :3, :3] @ points[..., None]).squeeze(-1) + 2 * quadric[..., :3, 3]
    return (linear * points).sum(-1) + quadric[..., 3, 3]


@dataclass(frozen=True, kw_only=True)
class RayHits:
    """Where rays meet truncated quadrics: origin + depth · direction."""

    near: Float[Tensor, "*batch"]
    """Depth of the nearer meeting point that is in front and not clipped away; infinite where there is none."""
    far: Float[Tensor, "*batch"]
    """Depth of the farther meeting point; infinite where there is none."""
    is_hit: Bool[Tensor, "*batch"]


@own_precision
def ray_table(
    quadrics: Float[Tensor, "*batch quadrics 4 4"],
    origins: Float[Tensor, "*batch rays 3"],
    directions: Float[Tensor, "*batch rays 3"],
) -> Float[Tensor, "3 *batch rays quadrics"]:
    """a, b, c of a s² + 2 b s + c, the value along origin + s · direction, of every ray and every quadric.

    Three matrix products.
    """
    weights = quadrics.flatten(-2).transpose(-1, -2)  # *batch 16 quadrics
    point = torch.cat((origins, torch.ones_like(origins[..., :1])), -1)
    towards = torch.cat((directions, torch.zeros_like(directions[..., :1])), -1)
    pairs = ((towards, towards), (point, towards), (point, point))
    return torch.stack([(left[..., :, None] * right[..., None, :]).flatten(-2) @ weights for left, right in pairs])


@own_precision
def meet_rays(along: Float[Tensor, "3 *batch"], clip: Float[Tensor, "3 *batch"]) -> RayHits:
    """Both meeting points of rays with truncated quadrics (Stenger et al. 2001, equation 9).

    `along` and `clip` are the coefficients of Q and of Π along the rays. The paper solves for the inverse depth s;
    depth is used here because orthographic rays have no other. Points behind the origin and points that fail Xᵀ Π X >=
    0 are discarded; a vanishing leading coefficient leaves the linear equation.
    """
    infinity = torch.full_like(along[0], torch.inf)
    kept = []
    for depth in quadratic_roots(*along):
        finite = torch.where(depth.isfinite(), depth, torch.zeros_like(depth))
        keeps = (clip[0] * finite + 2 * clip[1]) * finite + clip[2] >= 0
        kept.append(torch.where(depth.isfinite() & (depth > 0) & keeps, depth, infinity))
    near, far = torch.minimum(*kept), torch.maximum(*kept)
    far = torch.where(far.isfinite(), far, near)
    return RayHits(near=near, far=far, is_hit=near.isfinite())


@own_precision
def quadratic_roots(
    quadratic: Float[Tensor, "*batch"], linear: Float[Tensor, "*batch"], constant: Float[Tensor, "*batch"]
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Real roots of a s² + 2 b s + c, infinite where there are none.

    The root of larger magnitude is found without cancellation and gives the other by their product c / a, so a -> 0
    passes smoothly into the linear equation: the first root goes to infinity, the second to -c / 2b.
    """
    discriminant = linear * linear - quadratic * constant
    root = discriminant.clamp_min(0).sqrt()
    larger = -(linear + torch.where(linear >= 0, root, -root))
    infinity = torch.full_like(discriminant, torch.inf)
    one = torch.ones_like(quadratic)
    first = torch.where(quadratic == 0, infinity, larger / torch.where(quadratic == 0, one, quadratic))
    second = torch.where(larger == 0, first, constant / torch.where(larger == 0, one, larger))
    is_real = discriminant >= 0
    return torch.where(is_real, first, infinity), torch.where(is_real, second, infinity)
