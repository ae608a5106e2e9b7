"""What a fit needs of a hull besides its field: points spread over its surface with normals, and silhouette rays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand import volume
from torchhand.fit import Observation
from torchhand.fit.hull.rays import SilhouetteRays, silhouette_rays
from torchhand.geometry import Camera
from torchhand.volume import places_of

_NEWTON = 2  # steps onto the surface
_SPARE = 3  # times the points wanted are put onto it: where two sides meet, some do not get there
_NEAR = 0.25  # of the pitch: a point that is no nearer to the surface after them is left out


@runtime_checkable
class HullField(Protocol):
    """Signed distance from a hull's surface."""

    def sample(
        self, points: Float[Tensor, "*batch points 3"], /
    ) -> tuple[Float[Tensor, "*batch points"], Float[Tensor, "*batch points 3"]]:
        """Metres, negative inside, and its derivative in the place; finite for finite points, however far."""
        ...


@dataclass(frozen=True, kw_only=True)
class HullTarget:
    """A hull to fit a hand into, in the world."""

    field: HullField
    points: Float[Tensor, "hull 3"]
    """Points on the hull's surface, metres; none where there is no hull."""
    normals: Float[Tensor, "hull 3"]
    """Outward unit normals at the points."""
    inner: Float[Tensor, "inner 3"]
    """Grid points inside, metres."""
    depth: Float[Tensor, "inner"]
    """How deep they are, metres."""
    rays: SilhouetteRays | None = None
    """Rays that touch the object; None where only the hull is known."""
    observations: tuple[Observation, ...] = ()
    """What else is known of the hand at that time."""

    def where(self, may_be: Callable[[Tensor], Tensor]) -> "HullTarget":
        """The target with only those points, on the surface and inside, of which something is true; field and rays stay
        whole. The whole target where nothing inside is left."""
        surface, inside = may_be(self.points), may_be(self.inner)
        if not bool(inside.any()) or not bool(surface.any()):
            return self
        return replace(
            self,
            points=self.points[surface],
            normals=self.normals[surface],
            inner=self.inner[inside],
            depth=self.depth[inside],
        )

    @property
    def is_empty(self) -> bool:
        return not len(self.points)


def with_rays(
    target: HullTarget,
    cameras: Sequence[Camera],
    masks: Sequence[Bool[Tensor, "_height _width"] | None],
    *,
    count: int = 300,
) -> HullTarget:
    """The hull together with the edges of the silhouettes that it was carved from.

    masks: one per camera, None where a view is missing or not to be trusted. count: largest number of rays, over
    all views.

    Raises ValueError where there are not as many masks as cameras.
    """
    if len(masks) != len(cameras):
        raise ValueError(f"masks: expected one per camera, {len(cameras)}, got {len(masks)}")
    if target.is_empty:
        return target
    return replace(target, rays=silhouette_rays(cameras, masks, target.points.mean(0), count=count))


def target_of(field: volume.HullField, *, points: int = 500) -> HullTarget:
    """The hull of one frame, from the grid of its field.

    points: largest number of points of the surface; they are chosen evenly at random, the same ones for the same hull.

    Raises ValueError for the fields of several frames, and for no points.
    """
    if field.values.ndim != 3:
        raise ValueError(f"field: expected that of one frame, got a batch {tuple(field.values.shape[:-3])}")
    if points < 1:
        raise ValueError(f"points: expected 1 or more, got {points!r}")

    value, pitch = field.values.flatten(), field.pitch

    def grid(places: Int[Tensor, "n"]) -> Float[Tensor, "n 3"]:
        _, height, width = field.values.shape  # torch.unravel_index takes a second to import what it needs
        index = (places // (height * width), places // width % height, places % width)
        return field.origin + torch.stack(index, -1) * pitch

    inside, around = places_of(value < 0), places_of(value.abs() <= 0.9 * pitch)
    order = torch.randperm(len(around), generator=torch.Generator().manual_seed(0))[: _SPARE * points]
    near = grid(around[order.to(around.device)])
    for _ in range(_NEWTON):
        distance, gradient = field.sample(near)
        length = gradient.square().sum(-1, keepdim=True)
        near = near - (distance[:, None] * gradient / length.clamp_min(0.04)).clamp(-pitch, pitch)
    distance, gradient = field.sample(near)
    kept = places_of((distance.abs() <= _NEAR * pitch) & (gradient.norm(dim=-1) > 0.2))[:points]
    near, gradient = near[kept], gradient[kept]
    return HullTarget(
        field=field,
        points=near,
        normals=torch.nn.functional.normalize(gradient, dim=-1),
        inner=grid(inside),
        depth=-value[inside].to(near),
    )
