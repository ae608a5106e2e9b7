"""Rays through the edges of the silhouettes that a hull was carved from: each of them touches the hand somewhere.

A hull's surface is made of these rays. Each touches the hand at one place at least and may be away from it everywhere
else: where cameras look at a fist from four sides only, most of the hull's surface is no skin. So a ray tells what a
point of the surface does not, and it tells it to a fraction of a pixel.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit.hull.nearest import nearest_columns
from torchhand.geometry import Camera
from torchhand.image import boundary_points


@dataclass(frozen=True, kw_only=True)
class RayView:
    """The rays of one view."""

    camera: Camera
    scale: float
    """Metres that a unit of the normalised image plane is worth where the hull is."""
    plane: Float[Tensor, "rays 2"]
    """Points of the normalised image plane."""


@dataclass(frozen=True, kw_only=True)
class SilhouetteRays:
    """Rays through the edges of all silhouettes, view by view, in the world."""

    points: Float[Tensor, "rays 3"]
    """Points on the rays, beside the hull's middle, metres."""
    directions: Float[Tensor, "rays 3"]
    """Unit, away from the camera."""
    normals: Float[Tensor, "rays 3"]
    """Unit, across the ray and away from the silhouette: the hand is on the other side of the plane through the ray."""
    views: tuple[RayView, ...]

    def match(
        self, vertices: Float[Tensor, "hands points 3"], normals: Float[Tensor, "hands points 3"], *, turn: float
    ) -> Int[Tensor, "hands rays"]:
        """Vertex of each hand that each ray should touch: near it in its picture, and facing across it.

        normals: of the vertices. turn: metres that a turn of the surface by one radian is worth.
        """
        rays = self._stacked
        in_cam = rays.rotation @ vertices.to(rays.rotation).mT[:, None] + rays.translation  # hands views 3 points
        in_view = rays.scale * in_cam[:, :, :2] / torch.where(rays.is_orthographic, 1.0, in_cam[:, :, 2:])
        facing = (turn * normals).mT[:, None].expand(-1, len(self.views), -1, -1)
        skin = torch.cat((in_view.to(torch.float32), facing.to(torch.float32)), 2)
        wanted = torch.cat((rays.plane, turn * rays.normals), -1).to(torch.float32)
        found = nearest_columns(wanted, skin).flatten(1)
        return found if rays.kept is None else found.index_select(1, rays.kept)

    @cached_property
    def _stacked(self) -> "_StackedRays":
        return _StackedRays.of(self.views, self.normals)

    def thinned(self, count: int) -> "SilhouetteRays":
        """About so many of the rays, evenly over all; at least one of each view."""
        step = max(1, math.ceil(len(self.points) / count))
        return self.chosen([torch.arange(0, len(view.plane), step) for view in self.views])

    def chosen(self, rays: Sequence[Int[Tensor, "_kept"]]) -> "SilhouetteRays":
        """Some rays of each view, by their numbers in it. Views of which none is wanted drop out."""
        starts = itertools.accumulate((len(view.plane) for view in self.views), initial=0)
        own = [kept.to(self.points.device) for kept in rays]
        kept = torch.cat([start + numbers for start, numbers in zip(starts, own, strict=False)])
        views = tuple(
            replace(view, plane=view.plane[numbers])
            for view, numbers in zip(self.views, own, strict=True)
            if len(numbers)
        )
        return SilhouetteRays(
            points=self.points[kept], directions=self.directions[kept], normals=self.normals[kept], views=views
        )

    def nearest_to(self, places: Float[Tensor, "*batch rays 3"]) -> Float[Tensor, "*batch rays 3"]:
        """The point of each ray that is nearest to a place of its own."""
        points, directions = self.points.to(places), self.directions.to(places)
        return points + ((places - points) * directions).sum(-1, keepdim=True) * directions


@dataclass(frozen=True, kw_only=True)
class _StackedRays:
    """The rays of all views side by side, padded to the number of the view that has most; in float64."""

    rotation: Float[Tensor, "views 3 3"]
    translation: Float[Tensor, "views 3 1"]
    is_orthographic: Bool[Tensor, "views 1 1"]
    scale: Float[Tensor, "views 1 1"]
    plane: Float[Tensor, "views width 2"]
    """Times the scale."""
    normals: Float[Tensor, "views width 3"]
    kept: Int[Tensor, "rays"] | None
    """Places that hold rays; None where all do."""

    @classmethod
    def of(cls, views: Sequence[RayView], normals: Float[Tensor, "rays 3"]) -> "_StackedRays":
        counts = [len(view.plane) for view in views]
        width = max(counts)
        scale = normals.new_tensor([view.scale for view in views], dtype=torch.float64)[:, None, None]
        kept = None
        if min(counts) < width:
            kept = torch.cat([torch.arange(width * row, width * row + n) for row, n in enumerate(counts)])
            kept = kept.to(normals.device)
        pad = torch.nn.utils.rnn.pad_sequence
        return cls(
            rotation=torch.stack([view.camera.rotation for view in views]).to(scale),
            translation=torch.stack([view.camera.translation for view in views]).to(scale)[..., None],
            is_orthographic=torch.tensor([view.camera.kind == "orthographic" for view in views])[:, None, None].to(
                normals.device
            ),
            scale=scale,
            plane=scale * pad([view.plane for view in views], batch_first=True).to(scale),
            normals=pad(list(normals.split(counts)), batch_first=True).to(scale),
            kept=kept,
        )


def silhouette_rays(
    cameras: Sequence[Camera],
    masks: Sequence[Bool[Tensor, "_height _width"] | None],
    middle: Float[Tensor, "3"],
    *,
    count: int = 300,
) -> SilhouetteRays | None:
    """Rays through the edges of the silhouettes, as many for each view up to `count` in all.

    masks: one per camera, None where a view is missing or not to be trusted. middle: of the hull, metres. Where the
    object is cut off by the picture's edge there are no rays. None where no view has an edge.
    """
    seen = [(camera, mask) for camera, mask in zip(cameras, masks, strict=True) if mask is not None]
    parts: list[tuple[Tensor, ...]] = []
    views: list[RayView] = []
    for camera, mask in seen:
        edge = boundary_points(mask, max(1, count // len(seen)))
        height, width = mask.shape
        x, y = edge.points_px.unbind(-1)
        is_within = (x > 1) & (y > 1) & (x < width - 2) & (y < height - 2)
        place, outward = edge.points_px[is_within], edge.normals[is_within]
        if not len(place):
            continue
        tangent = torch.stack((-outward[:, 1], outward[:, 0]), -1)
        origin, along = camera.rays(torch.stack((place, place + tangent, place + outward)))
        rotation, translation = camera.rotation.to(along), camera.translation.to(along)
        parts.append(((origin - translation) @ rotation, along @ rotation))
        scale = 1.0 if camera.kind == "orthographic" else float(camera.cam_from_world(middle.to(along))[2])
        views.append(RayView(camera=camera, scale=scale, plane=(origin + along)[0, :, :2]))
    if not parts:
        return None
    origin, along = (torch.cat(one, 1) for one in zip(*parts, strict=True))
    on_plane = origin + along
    sideways, beyond = on_plane[1:] - on_plane[0]
    normal = torch.linalg.cross(along[0], sideways)
    normal = torch.nn.functional.normalize(normal * (normal * beyond).sum(-1, keepdim=True).sign(), dim=-1)
    along = torch.nn.functional.normalize(along[0], dim=-1)
    point = origin[0] + ((middle.to(along) - origin[0]) * along).sum(-1, keepdim=True) * along
    return SilhouetteRays(points=point, directions=along, normals=normal, views=tuple(views))
