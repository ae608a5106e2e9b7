"""A per-pixel ray caster over the same quadrics: exact masks, depth, part labels and shaded pictures."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchhand.geometry import Camera, quadratic_roots
from torchhand.hand import Implicit, Primitives
from torchhand.view.raster.boxes import pixel_boxes


@dataclass(frozen=True, kw_only=True)
class Raycast:
    """What one camera sees of one hand, pixel by pixel."""

    depth: Float[Tensor, "height width"]
    """z in the camera frame, metres; infinite where nothing is."""
    part: Int[Tensor, "height width"]
    """Part that the nearest surface belongs to, -1 where nothing is: of primitives the one of PRIMITIVE_NAMES, of a
    skinned mesh the bone of BONES."""
    normal: Float[Tensor, "height width 3"]
    """Unit outward normal in the camera frame; zero where nothing is."""

    @property
    def mask(self) -> Bool[Tensor, "height width"]:
        return self.part >= 0


def raycast(primitives_world: Primitives, camera: Camera) -> Raycast:
    """Casts a ray through the centre of every pixel at one hand (no batch dimension). Exact up to rounding.

    Each primitive meets only the rays of its own box in the picture; the nearest meeting point wins.
    """
    primitives = primitives_world.moved(camera.rotation, camera.translation)
    parts = primitives.implicit()
    boxes = pixel_boxes(primitives, camera)
    like = primitives.position
    size = (camera.height, camera.width)
    depth = torch.full(size, torch.inf, dtype=like.dtype, device=like.device)
    part = torch.full(size, -1, dtype=torch.long, device=like.device)
    normal = torch.zeros(*size, 3, dtype=like.dtype, device=like.device)
    seen = [box for box in boxes if box[2] > box[0] and box[3] > box[1]]
    if not seen:
        return Raycast(depth=depth, part=part, normal=normal)
    left, top = min(box[0] for box in seen), min(box[1] for box in seen)
    right, bottom = max(box[2] for box in seen), max(box[3] for box in seen)
    rows, columns = (
        torch.arange(a, b, dtype=like.dtype, device=like.device) for a, b in ((top, bottom), (left, right))
    )
    grid = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1)
    plane = camera.plane_from_pixels(grid.reshape(-1, 2)).reshape(grid.shape)
    for index, (x0, y0, x1, y1) in enumerate(boxes):
        if x1 <= x0 or y1 <= y0:
            continue
        own = (slice(y0, y1), slice(x0, x1))
        points = plane[y0 - top : y1 - top, x0 - left : x1 - left]
        near, gradient = _meet(parts, index, points.reshape(-1, 2), camera.kind == "orthographic")
        near = near.reshape(points.shape[:-1])
        is_nearer = near < depth[own]
        depth[own] = torch.where(is_nearer, near, depth[own])
        part[own] = torch.where(is_nearer, index, part[own])
        normal[own] = torch.where(is_nearer[..., None], gradient.reshape(*points.shape[:-1], 3), normal[own])
    return Raycast(depth=depth, part=part, normal=torch.nn.functional.normalize(normal, dim=-1))


def _meet(parts: Implicit, index: int, plane: Tensor, is_orthographic: bool) -> tuple[Tensor, Tensor]:
    """Depth of the first point of one primitive on the rays through points of the plane, and half the gradient there.

    The nearer of the roots that lie in front of the camera and within the truncation.
    """
    upper, edge, axis = parts.upper[index, ..., 0], parts.edge[index, :, 0], parts.axis[index, :, 0]
    corner, low, high = parts.corner[index, 0], parts.low[index, 0], parts.high[index, 0]
    ones, zeros = torch.ones_like(plane[:, :1]), torch.zeros_like(plane[:, :1])
    if is_orthographic:
        start = torch.cat((plane, zeros), -1)
        along = upper[:, 2]
        quadratic = along[2].expand(len(plane))
        pulled = start @ upper
        linear = pulled[:, 2] + edge[2]
        constant = ((pulled + 2 * edge) * start).sum(-1) + corner
        base, slope = pulled + edge, along.expand_as(start)
        height, rise = start @ axis, axis[2].expand(len(plane))
    else:
        direction = torch.cat((plane, ones), -1)
        slope = direction @ upper
        quadratic, linear, constant = (slope * direction).sum(-1), direction @ edge, corner.expand(len(plane))
        base = edge.expand_as(direction)
        height, rise = torch.zeros_like(linear), direction @ axis
    near = torch.full_like(linear, torch.inf)
    for root in quadratic_roots(quadratic, linear, constant):
        level = height + root * rise
        keeps = (root > 0) & (root < near) & (level >= low) & (level <= high)
        near = torch.where(keeps, root, near)
    finite = torch.where(near.isfinite(), near, torch.zeros_like(near))
    return near, base + finite[:, None] * slope


def shade(
    cast: Raycast,
    *,
    skin: tuple[float, float, float] = (0.85, 0.64, 0.53),
    background: UInt8[Tensor, "height width 3"] | None = None,
    light: tuple[float, float, float] = (-0.4, -0.6, -0.7),
    ambient: float = 0.35,
) -> UInt8[Tensor, "height width 3"]:
    """A Lambert-shaded RGB picture of the hand over a background (mid grey where none is given).

    light: direction towards the light in the camera frame (x right, y down, z forward); skin: RGB reflectance.
    """
    normal = cast.normal
    towards = torch.nn.functional.normalize(torch.tensor(light, dtype=normal.dtype, device=normal.device), dim=0)
    brightness = ambient + (1 - ambient) * (normal @ towards).clamp_min(0)
    colour = torch.tensor(skin, dtype=normal.dtype, device=normal.device) * brightness[..., None] * 255
    if background is None:
        background = torch.full((*cast.part.shape, 3), 128, dtype=torch.uint8, device=cast.part.device)
    return torch.where(cast.mask[..., None], colour.clamp(0, 255).round().to(torch.uint8), background)
