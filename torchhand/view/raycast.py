"""A per-pixel ray caster over the same quadrics: exact masks, depth, part labels and shaded pictures."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchhand.geometry import Camera, meet_rays, ray_table
from torchhand.hand import Primitives

_CHUNK = 1 << 15  # rays at once: keeps the table of all rays and quadrics in a few tens of MB


@dataclass(frozen=True, kw_only=True)
class Raycast:
    """What one camera sees of one hand, pixel by pixel."""

    depth: Float[Tensor, "height width"]
    """z in the camera frame, metres; infinite where nothing is."""
    part: Int[Tensor, "height width"]
    """Index into PRIMITIVE_NAMES of the nearest primitive, -1 where nothing is."""
    normal: Float[Tensor, "height width 3"]
    """Unit outward normal in the camera frame; zero where nothing is."""

    @property
    def mask(self) -> Bool[Tensor, "height width"]:
        return self.part >= 0


def raycast(primitives_world: Primitives, camera: Camera) -> Raycast:
    """Casts a ray through the centre of every pixel at one hand (no batch dimension). Exact up to rounding.

    Rays that cannot meet the hand (outside the box of its bounding spheres in the picture) are left out.
    """
    primitives = primitives_world.moved(camera.rotation, camera.translation)
    quadrics, clips = primitives.quadrics()
    dtype, device = quadrics.dtype, quadrics.device
    x0, y0, x1, y1 = _bounding_box(primitives, camera)
    depth = torch.full((camera.height, camera.width), torch.inf, dtype=dtype, device=device)
    part = torch.full((camera.height, camera.width), -1, dtype=torch.long, device=device)
    normal = torch.zeros(camera.height, camera.width, 3, dtype=dtype, device=device)
    if x1 <= x0 or y1 <= y0:
        return Raycast(depth=depth, part=part, normal=normal)
    rows = torch.arange(y0, y1, dtype=dtype, device=device)
    columns = torch.arange(x0, x1, dtype=dtype, device=device)
    grid_y, grid_x = torch.meshgrid(rows, columns, indexing="ij")
    origins, directions = camera.rays(torch.stack((grid_x, grid_y), -1).reshape(-1, 2))
    pieces = []
    for origin, direction in zip(origins.split(_CHUNK), directions.split(_CHUNK), strict=True):
        hits = meet_rays(ray_table(quadrics, origin, direction), ray_table(clips, origin, direction))
        near, nearest = hits.near.min(-1)
        point = origin + torch.where(near.isfinite(), near, torch.zeros_like(near))[:, None] * direction
        chosen = quadrics[nearest]
        gradient = (chosen[:, :3, :3] @ point[..., None]).squeeze(-1) + chosen[:, :3, 3]
        pieces.append((near, torch.where(near.isfinite(), nearest, -1), torch.nn.functional.normalize(gradient, dim=-1)))
    near, nearest, gradient = (torch.cat(column) for column in zip(*pieces, strict=True))
    size = (y1 - y0, x1 - x0)
    depth[y0:y1, x0:x1] = near.reshape(size)
    part[y0:y1, x0:x1] = nearest.reshape(size)
    normal[y0:y1, x0:x1] = torch.where((nearest >= 0)[:, None], gradient, torch.zeros_like(gradient)).reshape(*size, 3)
    return Raycast(depth=depth, part=part, normal=normal)


def _bounding_box(primitives: Primitives, camera: Camera) -> tuple[int, int, int, int]:
    """Pixels x0, y0, x1, y1 (exclusive) outside which no ray meets the hand; the whole picture where in doubt."""
    sizes = primitives.sizes
    reach = torch.maximum(torch.maximum(sizes.cone_start[..., 0], sizes.cone_start[..., 1]), sizes.cone_length)
    far = torch.maximum(sizes.cone_end_scale, torch.ones_like(reach)) * reach
    centres = torch.cat((primitives.cone_position, primitives.ellipsoid_position))
    radii = torch.cat((far + reach, sizes.ellipsoid_axes.amax(-1)))
    corners = torch.tensor([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=centres.dtype, device=centres.device)
    points = (centres[:, None] + radii[:, None, None] * corners).reshape(-1, 3)
    if camera.kind == "pinhole" and bool((points[:, 2] <= 1e-3).any()):
        return 0, 0, camera.width, camera.height
    pixels = camera.pixels_from_plane(camera.plane_from_cam(points))
    low, high = pixels.amin(0).floor().clamp(-1e6, 1e6), pixels.amax(0).ceil().clamp(-1e6, 1e6)
    margin = 8 if camera.has_distortion else 1
    x0, y0 = max(0, int(low[0]) - margin), max(0, int(low[1]) - margin)
    x1, y1 = min(camera.width, int(high[0]) + margin + 1), min(camera.height, int(high[1]) + margin + 1)
    return x0, y0, x1, y1


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
    towards = torch.nn.functional.normalize(torch.tensor(light, dtype=cast.normal.dtype, device=cast.normal.device), dim=0)
    brightness = ambient + (1 - ambient) * (cast.normal @ towards).clamp_min(0)
    colour = torch.tensor(skin, dtype=cast.normal.dtype, device=cast.normal.device) * brightness[..., None] * 255
    if background is None:
        background = torch.full((*cast.part.shape, 3), 128, dtype=torch.uint8, device=cast.part.device)
    return torch.where(cast.mask[..., None], colour.clamp(0, 255).round().to(torch.uint8), background)


