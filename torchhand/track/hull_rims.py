"""The edges of the silhouettes that a hull was carved from: rays that touch the hand somewhere.

A hull's surface is made of the rays through the silhouettes' edges. Each of these touches the hand at one place at
least and may be away from it everywhere else: where cameras look at a fist from four sides only, most of the hull's
surface is no skin. So a ray tells what a point of the surface does not, and it tells it to a fraction of a pixel.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.image.boundaries import boundary_points
from torchhand.residuals.hull_covered import nearest_points


@dataclass(frozen=True, kw_only=True)
class RimView:
    """The rays of one view."""

    camera: Camera
    scale: float
    """Metres that a unit of the normalised image plane is worth where the hull is."""
    plane: Float[Tensor, "rays 2"]
    """Of the normalised image plane."""


@dataclass(frozen=True, kw_only=True)
class HullRims:
    """Rays through the edges of all silhouettes, view by view, in the world."""

    points: Float[Tensor, "rays 3"]
    """On the rays, beside the hull's middle, metres."""
    along: Float[Tensor, "rays 3"]
    """Directions, unit, away from the camera."""
    normals: Float[Tensor, "rays 3"]
    """Unit, across the ray and away from the silhouette: the hand is on the other side of the plane through the ray."""
    views: tuple[RimView, ...]

    def match(
        self, vertices: Float[Tensor, "hands points 3"], normals: Float[Tensor, "hands points 3"], *, turn: float
    ) -> Int[Tensor, "hands rays"]:
        """For every ray the vertex of each hand that it should touch: near it in its picture, and facing across it.

        normals: of the vertices. turn: metres that a turn of the surface by one radian is worth.
        """
        found, first = [], 0
        for view in self.views:
            own = slice(first, first + len(view.plane))
            first = own.stop
            in_view = view.camera.plane_from_cam(view.camera.cam_from_world(vertices.double()))
            skin = torch.cat((view.scale * in_view.to(vertices), turn * normals), -1)
            rays = torch.cat((view.scale * view.plane.to(vertices), turn * self.normals[own].to(vertices)), -1)
            found.append(nearest_points(rays, skin))
        return torch.cat(found, -1)

    def thinned(self, count: int) -> "HullRims":
        """About so many of the rays, evenly over all; at least one of each view."""
        step = max(1, math.ceil(len(self.points) / count))
        lengths = [len(view.plane) for view in self.views]
        chosen = [torch.arange(0, length, step) for length in lengths]
        starts = itertools.accumulate(lengths, initial=0)
        kept = torch.cat([start + own for start, own in zip(starts, chosen, strict=False)]).to(self.points.device)
        views = tuple(replace(view, plane=view.plane[::step]) for view in self.views)
        return HullRims(points=self.points[kept], along=self.along[kept], normals=self.normals[kept], views=views)

    def near(self, places: Float[Tensor, "*batch rays 3"]) -> Float[Tensor, "*batch rays 3"]:
        """The point of each ray that is nearest to a place of its own."""
        points, along = self.points.to(places), self.along.to(places)
        return points + ((places - points) * along).sum(-1, keepdim=True) * along


def rims_of(
    cameras: Sequence[Camera],
    masks: Sequence[Bool[Tensor, "_height _width"] | None],
    middle: Float[Tensor, "3"],
    *,
    count: int = 300,
) -> HullRims | None:
    """Rays through the edges of the silhouettes, as many for each view up to `count` in all.

    masks: one per camera, None where a view is missing or not to be trusted. middle: of the hull, metres. Where the
    object is cut off by the picture's edge there are no rays. None where no view has an edge.
    """
    seen = [(camera, mask) for camera, mask in zip(cameras, masks, strict=True) if mask is not None]
    parts: list[tuple[Tensor, ...]] = []
    views: list[RimView] = []
    for camera, mask in seen:
        edge = boundary_points(mask, max(1, count // len(seen)))
        height, width = mask.shape
        x, y = edge.points_px.unbind(-1)
        is_within = (x > 1) & (y > 1) & (x < width - 2) & (y < height - 2)
        place, outward = edge.points_px[is_within], edge.normals[is_within]
        if not len(place):
            continue
        tangent = torch.stack((-outward[:, 1], outward[:, 0]), -1)
        origin, along = camera.rays(place)
        on_plane = origin + along
        sideways, beyond = (sum(camera.rays(place + step)) - on_plane for step in (tangent, outward))
        normal = torch.linalg.cross(along, sideways)
        normal = torch.nn.functional.normalize(normal * (normal * beyond).sum(-1, keepdim=True).sign(), dim=-1)
        along = torch.nn.functional.normalize(along, dim=-1)
        centre = camera.cam_from_world(middle.to(origin))
        point = origin + ((centre - origin) * along).sum(-1, keepdim=True) * along
        rotation = camera.rotation.to(origin)
        parts.append(((point - camera.translation.to(origin)) @ rotation, along @ rotation, normal @ rotation))
        scale = 1.0 if camera.kind == "orthographic" else float(centre[2])
        views.append(RimView(camera=camera, scale=scale, plane=camera.plane_from_pixels(place)))
    if not parts:
        return None
    points, along, normals = (torch.cat(one) for one in zip(*parts, strict=True))
    return HullRims(points=points, along=along, normals=normals, views=tuple(views))
