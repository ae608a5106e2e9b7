"""Self-occlusion of outline points by ray-quadric intersection (Stenger et al. 2001, section 4.2)."""

from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.devices import is_host
from torchhand.hand import Primitives
from torchhand.precision import EXACT, own_precision
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
    parts, own = primitives_cam.implicit(), table.primitive
    # Few numbers and many steps: numpy takes a third of torch's time for each.
    if is_host(points.device) and points.dtype in EXACT:
        arrays = (getattr(parts, field.name).detach().numpy() for field in fields(parts))
        with np.errstate(all="ignore"):
            free = torch.from_numpy(_is_free(np, _Parts(*arrays), points.numpy(), own.numpy(), slack, is_orthographic))
    else:
        tensors = (getattr(parts, field.name).detach() for field in fields(parts))
        free = _is_free(torch, _Parts(*tensors), points, own, slack, is_orthographic)
    return outline.is_real & free.reshape(*batch, count)


class _Parts(NamedTuple):
    """The fields of `Implicit`, as arrays or as tensors."""

    upper: Any
    edge: Any
    corner: Any
    axis: Any
    low: Any
    high: Any


def _is_free(xp: Any, parts: _Parts, points: Any, own: Any, slack: float, is_orthographic: bool) -> Any:
    """Whether points (hands, points, 3) lie before the camera and no part but their own hides them; (hands, points).

    xp: numpy or torch, whose arrays the others are.
    """
    axis = parts.axis.swapaxes(0, 2)  # hands, 3, parts
    if is_orthographic:
        depth = points[..., 2]
        table_of_rays, enough = _parallel_rays(xp, parts, points), depth - slack
        start, rate = points[..., :2] @ axis[:, :2], axis[:, 2:]
    else:
        # Depths along the ray to a point are counted in units of that point's distance.
        distance = xp.clip(xp.sqrt((points * points).sum(-1)), 1e-12, None)
        depth = xp.ones_like(distance)
        table_of_rays, enough = _central_rays(xp, parts, points), 1 - slack / distance
        start, rate = xp.zeros_like(points[:, :1, :1]), points @ axis
    quadratic, linear, constant = table_of_rays
    discriminant = linear * linear - quadratic * constant
    discriminant[:, xp.arange(len(own)), own] = -1.0  # not by itself
    # Few of all pairs meet: the rest is done for these alone.
    hand, point, part = xp.argwhere(discriminant >= 0).T
    shape = discriminant.shape

    def of_pairs(values: Any) -> Any:
        return xp.broadcast_to(values, shape)[hand, point, part]

    square, line, rest, begin, speed = (of_pairs(values) for values in (quadratic, linear, constant, start, rate))
    low, high = (of_pairs(bound.T[:, None]) for bound in (parts.low, parts.high))
    hits = []
    for root in _roots(xp, square, line, rest, discriminant[hand, point, part]):
        height = begin + root * speed
        keeps = (root > 0) & (root < xp.inf) & (height >= low) & (height <= high)
        hits.append(xp.where(keeps, root, xp.inf))
    near, far = xp.minimum(*hits), xp.maximum(*hits)
    here = depth[hand, point]
    hides = near < enough[hand, point]
    swallows = (near < here) & (far > here) & (far < xp.inf)
    is_hidden, chosen = xp.zeros_like(depth, dtype=bool), hides | swallows
    is_hidden[hand[chosen], point[chosen]] = True
    return (depth > 0) & ~is_hidden


def _roots(xp: Any, quadratic: Any, linear: Any, constant: Any, discriminant: Any) -> tuple[Any, Any]:
    """`quadratic_roots` where there are some."""
    root = xp.sqrt(discriminant)
    larger = -(linear + xp.where(linear >= 0, root, -root))
    first = xp.where(quadratic == 0, xp.inf, larger / xp.where(quadratic == 0, 1.0, quadratic))
    return first, xp.where(larger == 0, first, constant / xp.where(larger == 0, 1.0, larger))


def _central_rays(xp: Any, parts: _Parts, points: Any) -> tuple[Any, Any, Any]:
    """Coefficients of Q along s · point: (hands, points, parts) each, or broadcast against it."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    products = xp.stack((x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z), -1)
    entries = parts.upper[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].swapaxes(0, 2)
    return products @ entries, points @ parts.edge.swapaxes(0, 2), parts.corner.T[:, None]


def _parallel_rays(xp: Any, parts: _Parts, points: Any) -> tuple[Any, Any, Any]:
    """Coefficients of Q along (x, y, s): (hands, points, parts) each, or broadcast against it."""
    upper, edge = xp.moveaxis(parts.upper, -1, 0)[:, None], xp.moveaxis(parts.edge, -1, 0)[:, None]
    x, y = points[..., None, 0], points[..., None, 1]
    linear = upper[..., 2, 0] * x + upper[..., 2, 1] * y + edge[..., 2]
    constant = upper[..., 0, 0] * x * x + 2 * upper[..., 0, 1] * x * y + upper[..., 1, 1] * y * y
    return upper[..., 2, 2], linear, constant + 2 * (edge[..., 0] * x + edge[..., 1] * y) + parts.corner.T[:, None]
