"""A per-pixel ray caster over the same quadrics: exact masks, depth, part labels and shaded pictures."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchhand.geometry import Camera, quadratic_roots
from torchhand.hand import Implicit, Primitives
from torchhand.precision import own_precision
from torchhand.view.raster.boxes import pixel_boxes

_RAYS_AT_ONCE = 1 << 17


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


@own_precision
def raycast(primitives_world: Primitives, camera: Camera) -> Raycast:
    """Casts a ray through the centre of every pixel at one hand (no batch dimension). Exact up to rounding.

    Each primitive meets only the rays of its own box in the picture; the nearest meeting point wins.
    """
    camera = camera.to(dtype=primitives_world.position.dtype)
    primitives = primitives_world.moved(camera.rotation, camera.translation)
    parts = primitives.implicit()
    like, size = primitives.position, (camera.height, camera.width)
    depth = torch.full(size, torch.inf, dtype=like.dtype, device=like.device)
    part = torch.full(size, -1, dtype=torch.long, device=like.device)
    normal = torch.zeros(*size, 3, dtype=like.dtype, device=like.device)
    boxes = {i: box for i, box in enumerate(pixel_boxes(primitives, camera)) if box[2] > box[0] and box[3] > box[1]}
    if not boxes:
        return Raycast(depth=depth, part=part, normal=normal)
    left, top = min(box[0] for box in boxes.values()), min(box[1] for box in boxes.values())
    right, bottom = max(box[2] for box in boxes.values()), max(box[3] for box in boxes.values())
    rows, columns = (
        torch.arange(a, b, dtype=like.dtype, device=like.device) for a, b in ((top, bottom), (left, right))
    )
    grid = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1)
    plane = camera.plane_from_pixels(grid.reshape(-1, 2)).reshape(grid.shape)
    x, y = plane.unbind(-1)
    powers = torch.stack((x * x, x * y, y * y, x, y, torch.ones_like(x)), -1)
    is_orthographic = camera.kind == "orthographic"
    terms = _ray_terms(parts, is_orthographic)
    for together in _batches(boxes):
        owns = [(slice(y0 - top, y1 - top), slice(x0 - left, x1 - left)) for x0, y0, x1, y1 in together.values()]
        rays = [powers[own].reshape(-1, powers.shape[-1]) for own in owns]
        counts = torch.tensor([len(one) for one in rays], device=like.device)
        which = torch.tensor(list(together), device=like.device).repeat_interleave(counts)
        found = torch.cat([one @ terms[index] for index, one in zip(together, rays, strict=True)])
        near = _nearest(found, parts.low[which, 0], parts.high[which, 0])
        for (x0, y0, x1, y1), index, own in zip(together.values(), together, near.split(counts.tolist()), strict=True):
            box = (slice(y0, y1), slice(x0, x1))
            here = own.reshape(y1 - y0, x1 - x0)
            part[box].masked_fill_(here < depth[box], index)
            torch.minimum(depth[box], here, out=depth[box])
    seen = (part >= 0).nonzero(as_tuple=True)
    own, place = part[seen], plane[seen[0] - top, seen[1] - left]
    ahead = depth[seen][:, None]
    points = torch.cat((place if is_orthographic else place * ahead, ahead), -1)
    slope = (parts.upper[own, ..., 0] @ points[..., None]).squeeze(-1) + parts.edge[own, :, 0]
    normal[seen] = torch.nn.functional.normalize(slope, dim=-1)
    return Raycast(depth=depth, part=part, normal=normal)


def _batches(boxes: dict[int, tuple[int, int, int, int]]) -> Iterator[dict[int, tuple[int, int, int, int]]]:
    """The boxes in order, as many at a time as their rays may be held together; one at least."""
    together: dict[int, tuple[int, int, int, int]] = {}
    count = 0
    for index, box in boxes.items():
        rays = (box[2] - box[0]) * (box[3] - box[1])
        if together and count + rays > _RAYS_AT_ONCE:
            yield together
            together, count = {}, 0
        together[index] = box
        count += rays
    yield together


def _ray_terms(parts: Implicit, is_orthographic: bool) -> Float[Tensor, "37 6 5"]:
    """Coefficients of what is needed of a ray and a primitive, all of them polynomials in the ray's place (x, y) on the
    plane: rows x², xy, y², x, y, 1; columns quadratic, half linear, constant term of the quadric along the ray's depth,
    start and rise of the height between the clips."""
    upper, edge, corner, axis = parts.upper[..., 0], parts.edge[..., 0], parts.corner[:, 0], parts.axis[..., 0]
    terms = upper.new_zeros(len(upper), 6, 5)
    square = torch.stack((upper[:, 0, 0], 2 * upper[:, 0, 1], upper[:, 1, 1]), -1)
    if is_orthographic:
        terms[:, 5, 0] = upper[:, 2, 2]
        terms[:, 3:5, 1], terms[:, 5, 1] = upper[:, :2, 2], edge[:, 2]
        terms[:, :3, 2], terms[:, 3:5, 2], terms[:, 5, 2] = square, 2 * edge[:, :2], corner
        terms[:, 3:5, 3], terms[:, 5, 4] = axis[:, :2], axis[:, 2]
    else:
        terms[:, :3, 0], terms[:, 3:5, 0], terms[:, 5, 0] = square, 2 * upper[:, :2, 2], upper[:, 2, 2]
        terms[:, 3:, 1], terms[:, 5, 2], terms[:, 3:, 4] = edge, corner, axis
    return terms


def _nearest(terms: Float[Tensor, "rays 5"], low: Float[Tensor, "rays"], high: Float[Tensor, "rays"]) -> Tensor:
    """Depth of the first point on rays, infinite where there is none: the nearer of the roots that lie in front of the
    camera and within the truncation."""
    quadratic, linear, constant, height, rise = terms.T.contiguous()
    near = torch.full_like(linear, torch.inf)
    for root in quadratic_roots(quadratic, linear, constant):
        level = height + root * rise
        keeps = (root > 0) & (root < near) & (level >= low) & (level <= high)
        near = torch.where(keeps, root, near)
    return near


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
