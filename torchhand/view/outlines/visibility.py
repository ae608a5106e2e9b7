"""Self-occlusion of outline points by ray-quadric intersection (Stenger et al. 2001, section 4.2)."""

import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.geometry import quadratic_roots
from torchhand.hand import Implicit, Primitives
from torchhand.precision import own_precision
from torchhand.view.outlines.outline import Outline, OutlineTable

DEFAULT_SLACK = 1.5e-3
"""Metres by which an occluder must lie in front: neighbouring parts overlap at the joints."""


@own_precision
def visible_points(
    primitives_cam: Primitives,
    outline: Outline,
    table: OutlineTable,
    *,
    is_orthographic: bool = False,
    slack: float = DEFAULT_SLACK,
) -> Bool[Tensor, "*batch points"]:
    """Which outline points the camera sees: real, not behind another primitive and not inside one.

    A point is hidden if the ray to it meets another primitive, within that one's own truncation and in front of the
    camera, nearer by more than `slack` (metres); a point inside another primitive is an internal outline at a joint
    and is dropped too. Truncated parts are open at their ends, where the neighbour that closes them takes over.
    """
    batch, count = outline.points_cam.shape[:-2], outline.points_cam.shape[-2]
    points = outline.points_cam.detach().reshape(-1, count, 3)
    parts = primitives_cam.implicit()
    if is_orthographic:
        table_of_rays, depth, near_enough = _parallel_rays(parts, points), points[..., 2], points[..., 2] - slack
        origin, direction = (
            points * points.new_tensor((1.0, 1.0, 0.0)),
            points.new_tensor((0.0, 0.0, 1.0)).expand_as(points),
        )
    else:
        # Depths along the ray to a point are counted in units of that point's distance.
        distance = points.norm(dim=-1).clamp_min(1e-12)
        table_of_rays, depth, near_enough = (
            _central_rays(parts, points),
            torch.ones_like(distance),
            1 - slack / distance,
        )
        origin, direction = torch.zeros_like(points), points
    quadratic, linear, constant = table_of_rays
    discriminant = linear * linear - quadratic * constant
    discriminant.scatter_(-1, table.primitive.expand(len(points), -1)[..., None], -1.0)  # not by itself
    # Few of all pairs meet: the rest is done for these alone.
    hand, point, part = (discriminant >= 0).nonzero(as_tuple=True)
    roots = quadratic_roots(*(x.expand_as(discriminant)[hand, point, part] for x in (quadratic, linear, constant)))
    axis, low, high = _clips(parts, hand, part)
    start = (axis * origin[hand, point]).sum(-1)
    rate = (axis * direction[hand, point]).sum(-1)
    kept = []
    for root in roots:
        height = start + root * rate
        keeps = (root > 0) & root.isfinite() & (height >= low) & (height <= high)
        kept.append(torch.where(keeps, root, torch.inf))
    near, far = torch.minimum(*kept), torch.maximum(*kept)
    here = depth[hand, point]
    hides = near < near_enough[hand, point]
    swallows = (near < here) & (far > here) & far.isfinite()
    is_hidden = torch.zeros_like(depth, dtype=torch.bool)
    covered = hides | swallows
    is_hidden[hand[covered], point[covered]] = True
    return outline.is_real & ((depth > 0) & ~is_hidden).reshape(*batch, count)


def _central_rays(parts: Implicit, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Coefficients of Q along s · point: (hands, points, parts) each, or broadcast against it."""
    upper, edge, corner = (x.movedim(-1, 0) for x in (parts.upper, parts.edge, parts.corner))
    x, y, z = points.unbind(-1)
    products = torch.stack((x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z), -1)
    entries = (upper[:, :, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    return products @ torch.stack(tuple(entries), 1), points @ edge.transpose(-1, -2), corner[:, None]


def _parallel_rays(parts: Implicit, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Coefficients of Q along (x, y, s): (hands, points, parts) each, or broadcast against it."""
    upper, edge, corner = (x.movedim(-1, 0)[:, None] for x in (parts.upper, parts.edge, parts.corner))
    x, y = points[..., None, 0], points[..., None, 1]
    linear = upper[..., 2, 0] * x + upper[..., 2, 1] * y + edge[..., 2]
    constant = upper[..., 0, 0] * x * x + 2 * upper[..., 0, 1] * x * y + upper[..., 1, 1] * y * y
    return upper[..., 2, 2], linear, constant + 2 * (edge[..., 0] * x + edge[..., 1] * y) + corner


def _clips(parts: Implicit, hand: Tensor, part: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Axis and bounds of the part of each pair."""
    return parts.axis.movedim(-1, 0)[hand, part], parts.low[part, hand], parts.high[part, hand]
