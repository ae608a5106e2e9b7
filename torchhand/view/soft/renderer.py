"""Silhouettes and depth of closed meshes, differentiable in everything that moves them: pose, shape and camera."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.precision import own_precision
from torchhand.view.soft.boundary import Kept, boundary, with_moving_boundary
from torchhand.view.soft.depth import depth_samples, depth_within, jumps
from torchhand.view.soft.edges import contour_edges, faces_seen, mesh_edges
from torchhand.view.soft.placed import PlacedMeshes

_LEAST_COVERAGE = 1e-2  # where less is covered the depth hardly depends on what moves


@dataclass(frozen=True, kw_only=True)
class SoftPicture:
    """What one camera sees of each hand of a batch, averaged over every pixel's area; differentiable once."""

    coverage: Float[Tensor, "*batch height width"]
    """Share of the pixel that shows the hand, 0 to 1."""
    depth: Float[Tensor, "*batch height width"]
    """Mean depth of what the pixel shows of the hand: z in the camera frame, metres. 0 where the coverage is 0."""


class SoftRenderer:
    """Pictures of closed meshes that share their faces.

    Edges are sharp and pixels average over their areas, so there is no width of blur to choose, and derivatives are
    those of the areas themselves. Meshes may have any batch shape; a batch of cameras stands before meshes of the same
    batch shape. Where a lens distorts, vertices are carried through it and the edges between them stay straight.

        renderer = SoftRenderer(hand.faces)
        coverage = renderer.silhouette(hand(pose).vertices, camera)
    """

    def __init__(self, faces: Int[Tensor, "faces 3"]) -> None:
        """faces: counter-clockwise seen from outside. Raises ValueError for a mesh that is not closed."""
        self.faces = faces.long()
        self._edges = mesh_edges(faces)

    @own_precision
    def silhouette(
        self, vertices_world: Float[Tensor, "*batch vertices 3"], camera: Camera
    ) -> Float[Tensor, "*batch height width"]:
        """Share of each pixel's area that shows the hand, 0 to 1. vertices_world: metres.

        Exact but for rounding, and continuous in the vertices; so are its derivatives, but where a face turns away from
        the camera. Faces nearer to the camera than 1 mm, or behind it, are left out.
        """
        placed = self._placed(vertices_world, camera, kept="outer")
        covered = _coverage(placed)
        return covered.reshape(*vertices_world.shape[:-2], *covered.shape[1:])

    @own_precision
    def picture(self, vertices_world: Float[Tensor, "*batch vertices 3"], camera: Camera) -> SoftPicture:
        """Silhouette and depth; arguments as in `silhouette`.

        The depth of a pixel is the mean of four samples; where the hand only touches a pixel, that of its edge.
        Derivatives are those of the surface at the samples, and of the edges that hide another part of the hand.
        """
        placed = self._placed(vertices_world, camera, kept="all")
        covered = _coverage(placed)
        shape = (*vertices_world.shape[:-2], *covered.shape[1:])
        samples = depth_samples(placed, self.faces)
        depth = depth_within(placed, samples)
        share = placed.boundary.coverage.reshape(-1).index_select(0, placed.boundary.pixel)
        jump = jumps(placed, samples, depth) / share.clamp_min(_LEAST_COVERAGE)
        depth = with_moving_boundary(depth, placed.flat_px, placed.boundary, jump)
        return SoftPicture(coverage=covered.reshape(shape), depth=depth.reshape(shape))

    def _placed(self, vertices_world: Tensor, camera: Camera, *, kept: Kept) -> PlacedMeshes:
        points = camera.cam_from_world(vertices_world)
        points_px = camera.pixels_from_plane(camera.plane_from_cam(points)).reshape(-1, points.shape[-2], 2)
        depth = points[..., 2].reshape(points_px.shape[:-1])
        size = (len(points_px), camera.height, camera.width)
        with torch.no_grad():
            (a, b), (c, d) = (row[..., :2].unbind(-1) for row in camera.intrinsics[..., :2, :].unbind(-2))
            is_mirrored = (a * d - b * c < 0).reshape(-1).to(points.device)
            is_seen = faces_seen(points_px, depth, self.faces, is_mirrored)
            contour = contour_edges(is_seen, self._edges, points_px.shape[1], is_mirrored)
            found = boundary(points_px.reshape(-1, 2), contour, size, kept=kept)
        return PlacedMeshes(
            points_px=points_px,
            nearness=-depth if camera.kind == "orthographic" else depth.reciprocal(),
            is_orthographic=camera.kind == "orthographic",
            is_seen=is_seen,
            contour=contour,
            boundary=found,
        )


def _coverage(placed: PlacedMeshes) -> Float[Tensor, "pictures height width"]:
    found = placed.boundary
    return with_moving_boundary(found.coverage, placed.flat_px, found, found.is_outer.to(found.coverage))
