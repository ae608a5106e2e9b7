"""A hand before a camera: pose in, outline points, contours with visibility, and silhouettes in pixels out."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import (
    CONE_NAMES,
    ELLIPSOID_NAMES,
    HandFrames,
    HandKinematics,
    Primitives,
    PrimitiveSizes,
    place_primitives,
    primitive_sizes,
)
from torchhand.view.outline import OutlineTable, outline, outline_table, pixel_normals
from torchhand.view.visibility import visible_points

_ARC_CORNERS = 24
_SHIFT = 4  # fractional bits of OpenCV's polygon coordinates


@dataclass(frozen=True, kw_only=True)
class Contour:
    """The reference contour of one hand: what paper 003 calls the list I0 with its normals."""

    points_px: Float[Tensor, "points 2"]
    normals: Float[Tensor, "points 2"]
    """Unit, outward, in the picture."""
    visible: Bool[Tensor, "points"]
    """Real, in front of the camera and not occluded by the hand itself."""


class HandProjector:
    """Ties a kinematics module, a shape and a camera together. Cheap to make; holds no state but these."""

    def __init__(
        self, kinematics: HandKinematics, camera: Camera, shape: Float[Tensor, "*batch shape"] | None = None
    ) -> None:
        self.kinematics = kinematics
        self.camera = camera
        self.shape = kinematics.default_shape if shape is None else shape
        self.sizes: PrimitiveSizes = primitive_sizes(kinematics.shape_space, self.shape)
        self._polygon_table = _polygon_table(self.shape.dtype)

    @property
    def is_orthographic(self) -> bool:
        return self.camera.kind == "orthographic"

    def frames(self, pose: Float[Tensor, "*batch 36"], root_reference: Float[Tensor, "3 3"]) -> HandFrames:
        """Bones and keypoints in the world."""
        return self.kinematics(pose, self.shape, root_reference=root_reference)

    def primitives_cam(self, frames: HandFrames) -> Primitives:
        """The 37 quadrics in the camera frame."""
        placed = place_primitives(frames, self.sizes, is_left=self.kinematics.side == "left")
        return placed.moved(self.camera.rotation, self.camera.translation)

    def outline_px(
        self, pose: Float[Tensor, "*batch 36"], root_reference: Float[Tensor, "3 3"], table: OutlineTable
    ) -> Float[Tensor, "*batch points 2"]:
        """Outline points of the table in pixels for a batch of poses; no visibility."""
        seen = outline(self.primitives_cam(self.frames(pose, root_reference)), table, is_orthographic=self.is_orthographic)
        return self.camera.pixels_from_plane(self.camera.plane_from_cam(seen.points_cam))

    def contour(
        self, pose: Float[Tensor, "36"], root_reference: Float[Tensor, "3 3"], table: OutlineTable
    ) -> Contour:
        """The reference contour of one pose, with normals and self-occlusion."""
        primitives = self.primitives_cam(self.frames(pose, root_reference))
        seen = outline(primitives, table, is_orthographic=self.is_orthographic)
        plane = self.camera.plane_from_cam(seen.points_cam)
        visible = visible_points(primitives, seen, table, is_orthographic=self.is_orthographic)
        return Contour(
            points_px=self.camera.pixels_from_plane(plane),
            normals=pixel_normals(self.camera, plane, seen.normals_cam),
            visible=visible & (seen.points_cam[..., 2] > 0),
        )

    def silhouette(self, pose: Float[Tensor, "36"], root_reference: Float[Tensor, "3 3"]) -> Bool[Tensor, "height width"]:
        """Filled union of the primitives' outlines: `raycast(...).mask` to about a pixel, in well under a millisecond.

        Each primitive is filled as the convex polygon of its outline; whole ellipsoids stand for the halves that close the
        palm and the fingertips, whose other half lies within the part they close.
        """
        primitives = self.primitives_cam(self.frames(pose, root_reference))
        seen = outline(_unclipped(primitives), self._polygon_table, is_orthographic=self.is_orthographic)
        pixels = self.camera.pixels_from_plane(self.camera.plane_from_cam(seen.points_cam))
        usable = seen.is_real & (seen.points_cam[..., 2] > 0) & pixels.isfinite().all(-1)
        corners = np.round(pixels.nan_to_num(0).clamp(-1e5, 1e5).detach().cpu().numpy() * (1 << _SHIFT)).astype(np.int32)
        canvas = np.zeros((self.camera.height, self.camera.width), dtype=np.uint8)
        count = 4 * len(CONE_NAMES)
        polygons = [*np.split(corners[:count], len(CONE_NAMES)), *np.split(corners[count:], len(ELLIPSOID_NAMES))]
        keeps = [*usable[:count].split(4), *usable[count:].split(_ARC_CORNERS)]
        for polygon, keep in zip(polygons, keeps, strict=True):
            if bool(keep.all()):
                cv2.fillConvexPoly(canvas, polygon, 1, shift=_SHIFT)
        return torch.from_numpy(canvas).bool()


def _polygon_table(dtype: torch.dtype) -> OutlineTable:
    """Corners of every primitive's outline in drawing order."""
    arcs = outline_table(1, _ARC_CORNERS, dtype=dtype)
    cones = torch.arange(len(CONE_NAMES))
    return OutlineTable(
        cone=cones.repeat_interleave(4),
        cone_side=torch.tensor((0, 0, 1, 1)).repeat(len(cones)),
        cone_fraction=torch.tensor((0.0, 1.0, 1.0, 0.0), dtype=dtype).repeat(len(cones)),
        ellipsoid=arcs.ellipsoid,
        ellipsoid_fraction=arcs.ellipsoid_fraction,
    )


def _unclipped(primitives: Primitives) -> Primitives:
    sizes = primitives.sizes
    return replace(primitives, sizes=replace(sizes, ellipsoid_level=torch.full_like(sizes.ellipsoid_level, -2.0)))
