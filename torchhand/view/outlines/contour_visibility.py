"""Which points of the outlines of many hands are seen, and beside which the picture shows no other part of the hand.

What `visible_points` tells, asked twice, in a fraction of the time: all rays are tried against the outline conics of
all parts in one product, and only the few that meet one are followed.

On a ray through (x, y, 1) a quadric is s t² + 2 l t + f, where t is the depth for parallel rays and 1 / depth for
central ones, s belongs to the quadric, l is linear and f quadratic in (x, y, 1). It has roots where the conic l² - s f
is not negative.
"""

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor, is_host
from torchhand.view.outlines.outline import OutlineTable
from torchhand.view.outlines.visibility import DEFAULT_SLACK

_HANDS_AT_ONCE = 8  # whose products stay in the processor's memory
_FOLD = (  # from the entries of a symmetric matrix to the coefficients of x², xy, y², x, y, 1
    *((1, 0, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0), (0, 0, 0, 1, 0, 0)),
    *((0, 1, 0, 0, 0, 0), (0, 0, 1, 0, 0, 0), (0, 0, 0, 0, 1, 0)),
    *((0, 0, 0, 1, 0, 0), (0, 0, 0, 0, 1, 0), (0, 0, 0, 0, 0, 1)),
)


@dataclass(frozen=True, kw_only=True)
class Quadrics:
    """Q = [[A, b], [bᵀ, c]] of the parts of some hands in the camera's frame, and where each is cut off."""

    upper: Float[Tensor, "hands 37 3 3"]
    """A of the quadrics [[A, b], [bᵀ, c]]."""
    edge: Float[Tensor, "hands 37 3"]
    """b of the quadrics [[A, b], [bᵀ, c]]."""
    corner: Float[Tensor, "hands 37"]
    """c of the quadrics [[A, b], [bᵀ, c]]."""
    axis: Float[Tensor, "hands 37 3"]
    """A point X is kept where low <= axis · X <= high."""
    low: Float[Tensor, "hands 37"]
    high: Float[Tensor, "hands 37"]


def seen_and_outer(
    quadrics: Quadrics,
    columns_cam: Float[Tensor, "hands 3 points"],
    beyond: Float[Tensor, "hands 2 points"],
    table: OutlineTable,
    is_real: Bool[Tensor, "hands points"],
    *,
    is_orthographic: bool = False,
    slack: float = DEFAULT_SLACK,
) -> tuple[Bool[Tensor, "hands points"], Bool[Tensor, "hands points"]]:
    """Which outline points the camera sees, as `visible_points`, and at which places beyond them it sees no other part.

    beyond: for every point the place on the normalised image plane. is_real: points that count; others are neither.
    """
    plane, depth = columns_cam[:, :2], columns_cam[:, 2]
    if is_orthographic:
        enough, follow = depth - slack, _along_parallel_rays
    else:
        plane, follow = plane / depth[:, None], _along_central_rays
        x, y, z = columns_cam.unbind(1)
        enough = depth - slack * depth / torch.addcmul(torch.addcmul(x * x, y, y), z, z).sqrt()
    nothing = torch.full_like(depth, torch.inf)  # every part hides what is far behind the hand
    x, y = torch.cat((plane, beyond), 2).unbind(1)
    rays = _Rays(
        products=torch.stack((x * x, x * y, y * y, x, y, torch.ones_like(x)), 1),
        depth=torch.cat((depth, nothing), 1),
        enough=torch.cat((enough, nothing), 1),
    )
    parts = follow(quadrics)
    is_other = torch.arange(quadrics.corner.shape[1], device=depth.device)[:, None] != table.primitive.repeat(2)
    groups = (slice(start, start + _HANDS_AT_ONCE) for start in range(0, max(1, len(x)), _HANDS_AT_ONCE))
    free = [_is_free(parts.hands(some), rays.hands(some), is_other, is_orthographic) for some in groups]
    seen, outer = torch.cat(free).chunk(2, 1)
    return is_real & seen, is_real & outer


@dataclass(frozen=True, kw_only=True)
class _Rays:
    products: Float[Tensor, "hands 6 rays"]
    """x², xy, y², x, y, 1"""
    depth: Float[Tensor, "hands rays"]
    """Depth of the point that the ray is for: a part that begins before it and ends behind it holds the point
    inside."""
    enough: Float[Tensor, "hands rays"]
    """A part that begins or ends before this hides it."""

    def hands(self, some: slice) -> "_Rays":
        return _Rays(**{f.name: getattr(self, f.name)[some] for f in fields(self)})


@dataclass(frozen=True, kw_only=True)
class _Parts:
    """The quadrics along the rays."""

    conic: Float[Tensor, "hands 37 6"]
    """Coefficients of the conic, in terms of the rays' products."""
    rows: Float[Tensor, "hands 10 37"]
    """l, then axis, both of (x, y, 1); s; rate, low, high. A part ends where axis + rate t is low and high, all of this
    over the depth where rays are central."""

    def hands(self, some: slice) -> "_Parts":
        return _Parts(conic=self.conic[some], rows=self.rows[some])


def _along_central_rays(quadrics: Quadrics) -> _Parts:
    q = quadrics
    return _parts(q, form=q.upper, line=q.edge, scalar=q.corner, axis=q.axis, rate=torch.zeros_like(q.corner))


def _along_parallel_rays(quadrics: Quadrics) -> _Parts:
    q = quadrics
    edge = torch.cat((q.edge[..., :2], q.corner[..., None]), -1)
    form = torch.cat((torch.cat((q.upper[..., :2, :2], edge[..., None, :2]), -2), edge[..., None]), -1)
    line = torch.cat((q.upper[..., 2, :2], q.edge[..., 2:]), -1)
    across = torch.nn.functional.pad(q.axis[..., :2], (0, 1))
    return _parts(q, form=form, line=line, scalar=q.upper[..., 2, 2], axis=across, rate=q.axis[..., 2])


def _parts(quadrics: Quadrics, *, form: Tensor, line: Tensor, scalar: Tensor, axis: Tensor, rate: Tensor) -> _Parts:
    conic = line[..., :, None] * line[..., None, :] - scalar[..., None, None] * form
    rows = torch.stack((*line.unbind(-1), *axis.unbind(-1), scalar, rate, quadrics.low, quadrics.high), 1)
    return _Parts(conic=conic.flatten(-2) @ constant_tensor(_FOLD, conic.dtype, conic.device), rows=rows)


def _is_free(
    parts: _Parts, rays: _Rays, is_other: Bool[Tensor, "37 rays"], is_orthographic: bool
) -> Bool[Tensor, "hands rays"]:
    """Whether no other part hides what is looked at."""
    squares = parts.conic @ rays.products
    limits = (rays.depth, rays.enough) if is_orthographic else (rays.depth.reciprocal(), rays.enough.reciprocal())
    of_rays = (rays.products[:, 3], rays.products[:, 4], *limits)
    if not is_host(squares.device):  # every pair: how many meet is not known without waiting
        each_part = (row[..., None] for row in parts.rows.unbind(1))
        each_ray = (row[:, None] for row in of_rays)
        hides = _hides(tuple(each_part), tuple(each_ray), squares.clamp_min(0).sqrt(), is_orthographic)
        return ~(hides & (squares >= 0) & is_other).any(1)
    place, part, ray = _pairs(squares, is_other)
    of_parts = (row.index_select(0, part) for row in parts.rows.transpose(0, 1).flatten(1).unbind())
    met = (row.reshape(-1).index_select(0, ray) for row in of_rays)
    hides = _hides(tuple(of_parts), tuple(met), squares.view(-1).index_select(0, place).sqrt(), is_orthographic)
    count = torch.zeros_like(rays.depth)
    return count.view(-1).index_add_(0, ray, hides.to(count)).view(count.shape) == 0


def _hides(
    parts: tuple[Float[Tensor, "*#pairs"], ...],
    rays: tuple[Float[Tensor, "*#pairs"], ...],
    root: Float[Tensor, "*pairs"],
    is_orthographic: bool,
) -> Bool[Tensor, "*pairs"]:
    """Whether a part hides what is looked at along a ray that meets it.

    parts: rows of `_Parts`. rays: place on the image plane, and limits. root: of the conic there.
    """
    (lx, ly, lz, ax, ay, az, scalar, rate, low, high), (x, y, here, enough) = parts, rays
    line, height = (torch.addcmul(torch.addcmul(c, a, x), b, y) for a, b, c in ((lx, ly, lz), (ax, ay, az)))
    kept, nearer, hiding = [], [], []
    for t in ((root - line) / scalar, (-root - line) / scalar):
        if is_orthographic:
            along = height + rate * t
            kept.append((t > 0) & (along >= low) & (along <= high))
            nearer.append(t < here)
            hiding.append(t < enough)
        else:
            kept.append((t > 0) & (height >= low * t) & (height <= high * t))
            nearer.append(t > here)
            hiding.append(t > enough)
    return (kept[0] & hiding[0]) | (kept[1] & hiding[1]) | (kept[0] & kept[1] & (nearer[0] ^ nearer[1]))


def _pairs(
    squares: Float[Tensor, "hands 37 rays"], is_other: Bool[Tensor, "37 rays"]
) -> tuple[Int[Tensor, "k"], Int[Tensor, "k"], Int[Tensor, "k"]]:
    """Where a part and a ray meet: place among the squares, part and ray, the last two counted over all hands.

    By numpy, in a quarter of torch's time; for tensors in the processor's memory.
    """
    _, parts, rays = squares.shape
    place = np.flatnonzero((squares.numpy() >= 0) & is_other.numpy())
    part = place // rays
    ray = place - rays * (part - part // parts)
    place, part, ray = (torch.from_numpy(x) for x in (place, part, ray))
    return place, part, ray
