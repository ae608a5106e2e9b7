"""What a fit needs of a hull besides its field: points spread over its surface, with normals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand import volume
from torchhand.fit.hull.inside import HullField
from torchhand.fit.hull.rims import HullRims, rims_of
from torchhand.geometry import Camera
from torchhand.hand import Hand
from torchhand.volume import places_of

_NEWTON = 2  # steps onto the surface
_SPARE = 3  # times the points wanted are put onto it: where two sides meet, some do not get there
_NEAR = 0.25  # of the pitch: a point that is no nearer to the surface after them is left out


@dataclass(frozen=True, kw_only=True)
class HullTarget:
    """A hull to fit a hand into, in the world."""

    field: HullField
    points: Float[Tensor, "hull 3"]
    """On its surface, metres; none where there is no hull."""
    normals: Float[Tensor, "hull 3"]
    """Outward, unit."""
    inner: Float[Tensor, "inner 3"]
    """Grid points inside, metres."""
    depth: Float[Tensor, "inner"]
    """How deep they are, metres."""
    rims: HullRims | None = None
    """Rays that touch the object; None where only the hull is known."""

    def where(self, may_be: Callable[[Tensor], Tensor]) -> "HullTarget":
        """The same with only those points, on the surface and inside, of which something is true; field and rays stay
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


def with_rims(
    target: HullTarget,
    cameras: Sequence[Camera],
    masks: Sequence[Bool[Tensor, "_height _width"] | None],
    *,
    rays: int = 300,
) -> HullTarget:
    """The hull together with the edges of the silhouettes that it was carved from.

    masks: one per camera, None where a view is missing or not to be trusted. rays: most of them, over all views.

    Raises ValueError where there are not as many masks as cameras.
    """
    if len(masks) != len(cameras):
        raise ValueError(f"masks: expected one per camera, {len(cameras)}, got {len(masks)}")
    if target.is_empty:
        return target
    return replace(target, rims=rims_of(cameras, masks, target.points.mean(0), count=rays))


def hull_target(
    field: HullField,
    lower: Float[Tensor, "3"],
    upper: Float[Tensor, "3"],
    *,
    pitch: float = 0.004,
    points: int = 500,
) -> HullTarget:
    """The hull within a box, by its field on a grid.

    lower, upper: corners of a box around the hull, metres. pitch: of the grid, metres. points: most points of the
    surface; they are chosen evenly at random, the same ones for the same hull.

    Raises ValueError for a box without inside, for a pitch that is not positive, and for no points.
    """
    if not bool((upper > lower).all()):
        raise ValueError(f"box: expected upper above lower, got {lower.tolist()} and {upper.tolist()}")
    if not 0 < pitch < float("inf"):
        raise ValueError(f"pitch: expected above 0 and finite, got {pitch!r}")
    if points < 1:
        raise ValueError(f"points: expected 1 or more, got {points!r}")
    axes = [
        torch.arange(int(size) + 2, dtype=lower.dtype, device=lower.device) * pitch + low
        for size, low in zip(((upper - lower) / pitch).tolist(), lower, strict=True)
    ]
    grid = torch.cartesian_prod(*axes)
    return _of_grid(field, field.sample(grid)[0], grid.__getitem__, pitch, points)


def target_of(field: volume.HullField, *, points: int = 500) -> HullTarget:
    """The hull of one frame by its own grid: the same without asking the field at every grid point.

    Raises ValueError for the fields of several frames, and for no points.
    """
    if field.values.ndim != 3:
        raise ValueError(f"field: expected that of one frame, got a batch {tuple(field.values.shape[:-3])}")
    if points < 1:
        raise ValueError(f"points: expected 1 or more, got {points!r}")

    def grid(places: Int[Tensor, "n"]) -> Float[Tensor, "n 3"]:
        return field.origin + torch.stack(torch.unravel_index(places, field.values.shape), -1) * field.pitch

    return _of_grid(field, field.values.flatten(), grid, field.pitch, points)


def _of_grid(
    field: HullField, value: Float[Tensor, "n"], grid: Callable[[Tensor], Tensor], pitch: float, points: int
) -> HullTarget:
    """From the field's values at grid points; grid: where those with some numbers are."""
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


def spread_vertices(hand: Hand, count: int) -> tuple[Int[Tensor, "points"], Float[Tensor, "points"]]:
    """Vertices spread evenly over a hand's skin, and the share of its area that each stands for.

    Each is the farthest from those before it, on the open hand of the hand's default shape. At most as many as there
    are.
    """
    device = hand.faces.device
    vertices = hand.skinning.rest_vertices.T
    vertices = vertices + (hand.skinning.rest_basis @ hand.kinematics.metres(hand.kinematics.default_shape)).T
    a, b, c = vertices[hand.faces].unbind(1)
    of_face = torch.linalg.cross(b - a, c - a).norm(dim=-1) / 6
    area = torch.zeros(len(vertices), dtype=vertices.dtype, device=device)
    area = area.index_add(0, hand.faces.flatten(), of_face.repeat_interleave(3))
    chosen = [int(area.argmax())]
    nearest = (vertices - vertices[chosen[0]]).norm(dim=-1)
    owner = torch.zeros(len(vertices), dtype=torch.long, device=device)
    for index in range(1, min(count, len(vertices))):
        chosen.append(int(nearest.argmax()))
        apart = (vertices - vertices[chosen[-1]]).norm(dim=-1)
        closer = apart < nearest
        owner, nearest = torch.where(closer, index, owner), torch.minimum(nearest, apart)
    share = torch.zeros(len(chosen), dtype=vertices.dtype, device=device).index_add(0, owner, area)
    return torch.tensor(chosen, device=device), share / area.sum()
