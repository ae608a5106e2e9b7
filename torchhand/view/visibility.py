"""Self-occlusion of outline points by ray-quadric intersection (paper 003, section 4.2, with the rule of FACTS 4.4)."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import meet_rays, ray_table
from torchhand.hand import Primitives
from torchhand.view.outline import Outline, OutlineTable

DEFAULT_SLACK = 1.5e-3
"""Metres by which an occluder must lie in front: neighbouring parts overlap at the joints."""


def visible_points(
    primitives_cam: Primitives,
    outline: Outline,
    table: OutlineTable,
    *,
    is_orthographic: bool = False,
    slack: float = DEFAULT_SLACK,
) -> Bool[Tensor, "*batch points"]:
    """Which outline points the camera sees: real, not behind another primitive and not inside one.

    A point is hidden if the ray to it meets another primitive, within that one's own truncation and in front of the camera,
    nearer by more than `slack`; a point inside another primitive is an internal outline at a joint and is dropped too.
    """
    points = outline.points_cam
    if is_orthographic:
        directions = torch.zeros_like(points)
        directions[..., 2] = 1
        origins = points.clone()
        origins[..., 2] = 0
        depth = points[..., 2]
    else:
        depth = points.norm(dim=-1)
        directions = points / depth.clamp_min(1e-12)[..., None]
        origins = torch.zeros_like(points)
    quadrics, clips = primitives_cam.quadrics()
    hits = meet_rays(ray_table(quadrics, origins, directions), ray_table(clips, origins, directions))
    own = torch.nn.functional.one_hot(table.primitive, quadrics.shape[-3]).bool()
    hides = hits.is_hit & (hits.near < depth[..., None] - slack)
    # Entered before the point and left behind it: the point is inside. Truncated parts are open at their ends, where the
    # neighbour that closes them takes over.
    swallows = hits.is_hit & (hits.near < depth[..., None]) & (hits.far > depth[..., None]) & (hits.far > hits.near)
    return outline.is_real & (depth > 0) & ~((hides | swallows) & ~own).any(-1)


def inside_any(primitives: Primitives, points: Float[Tensor, "*batch points 3"]) -> Bool[Tensor, "*batch points"]:
    """Whether points lie inside the union of the truncated primitives, all in one frame."""
    quadrics, clips = primitives.quadrics()
    zero = torch.zeros_like(points)
    value = ray_table(quadrics, points, zero)[2]
    kept = ray_table(clips, points, zero)[2]
    return ((value < 0) & (kept >= 0)).any(-1)
