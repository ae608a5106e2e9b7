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
    axis = parts.axis.movedim(-1, 0)
    if is_orthographic:
        table_of_rays, depth, near_enough = _parallel_rays(parts, points), points[..., 2], points[..., 2] - slack
        start, rate = points[..., :2] @ axis[..., :2].mT, axis[:, None, :, 2]
    else:
        # Depths along the ray to a point are counted in units of that point's distance.
        distance = points.norm(dim=-1).clamp_min(1e-12)
        table_of_rays, depth, near_enough = (
            _central_rays(parts, points),
            torch.ones_like(distance),
            1 - slack / distance,
        )
        start, rate = torch.zeros_like(depth[..., None]), points @ axis.mT
    quadratic, linear, constant = table_of_rays
    discriminant = linear * linear - quadratic * constant
    discriminant.scatter_(-1, table.primitive.expand(len(points), -1)[..., None], -1.0)  # not by itself
    # Few of all pairs meet: the rest is done for these alone.
    met = (discriminant >= 0).flatten().nonzero().squeeze(-1)
    point = met // discriminant.shape[-1]  # of all hands

    def of_pairs(values: Tensor) -> Tensor:
        return values.expand_as(discriminant).reshape(-1).index_select(0, met)

    def of_points(values: Tensor) -> Tensor:
        return values.reshape(-1).index_select(0, point)

    roots = torch.stack(quadratic_roots(of_pairs(quadratic), of_pairs(linear), of_pairs(constant)))
    height = torch.addcmul(of_pairs(start), roots, of_pairs(rate))
    low, high = (of_pairs(bound.mT[:, None]) for bound in (parts.low, parts.high))
    keeps = (roots > 0) & (roots < torch.inf) & (height >= low) & (height <= high)
    hits = torch.where(keeps, roots, torch.inf)
    near, far = hits.amin(0), hits.amax(0)
    here = of_points(depth)
    hides = near < of_points(near_enough)
    swallows = (near < here) & (far > here) & (far < torch.inf)
    is_hidden = torch.zeros(depth.shape, dtype=torch.bool, device=depth.device)
    is_hidden.view(-1).index_fill_(0, point[hides | swallows], True)
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
