"""A hand before a camera: pose in, outline points, contours with visibility, and silhouettes in pixels out."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.devices import kept, sent_to
from torchhand.geometry import Camera, batch_first
from torchhand.hand import (
    CONE_NAMES,
    HandFrames,
    HandKinematics,
    Primitives,
    PrimitiveSizes,
    place_primitives,
    primitive_sizes,
)
from torchhand.precision import own_precision
from torchhand.view.outlines.generators import ConeGenerators, EllipsoidArcs, cone_sections, generators
from torchhand.view.outlines.outline import (
    OutlineTable,
    farthest_along,
    outline_of,
    outline_table,
    pixel_normals,
    sample_generators,
)
from torchhand.view.outlines.visibility import visible_points

Generators = tuple[ConeGenerators, EllipsoidArcs]

_ARC_CORNERS = 24
_SHIFT = 4  # fractional bits of OpenCV's polygon coordinates
_INSET_PX = 0.5
_FARTHEST_PX = 1e5  # farther corners do not fit into OpenCV's numbers


@dataclass(frozen=True, kw_only=True)
class Contour:
    """The reference contour of one hand: what Stenger et al. (2001) call the list I0 with its normals."""

    points_px: Float[Tensor, "points 2"]
    normals: Float[Tensor, "points 2"]
    """Unit, outward, in the picture."""
    visible: Bool[Tensor, "points"]
    """Real, in front of the camera and not occluded by the hand itself."""


@dataclass(frozen=True, kw_only=True)
class Polygons:
    """Convex polygons of hands before a camera, one to a primitive, whose union is the silhouette; the batch last."""

    corners: Float[Tensor, "corners 3 n"]
    """Corners in the camera frame, metres: four of each cone, then those of each ellipsoid."""
    is_real: Bool[Tensor, "primitives n"]
    """Whether the camera sees the primitive's outline."""

    @classmethod
    def of(cls, known: Generators) -> "Polygons":
        """Polygons on generators, which stand for whole ellipsoids in place of the kept parts."""
        with torch.no_grad():
            cones, arcs = known[0], known[1].whole()
            table = _polygon_table(cones.low.dtype, cones.low.device)
            return cls(corners=sample_generators(cones, arcs, table), is_real=torch.cat((cones.is_real, arcs.is_real)))

    def of_hand(self, index: int) -> "Polygons":
        """The part of one hand of the batch, with n = 1."""
        one = slice(index, index + 1)
        return Polygons(corners=self.corners[..., one], is_real=self.is_real[:, one])


class HandProjector:
    """Ties a kinematics module, a shape and a camera together. Cheap to make; holds no state but these."""

    def __init__(
        self, kinematics: HandKinematics, camera: Camera, shape: Float[Tensor, "*batch shape"] | None = None
    ) -> None:
        self.kinematics = kinematics
        self.camera = camera
        self.shape = kinematics.default_shape if shape is None else shape
        self.sizes: PrimitiveSizes = primitive_sizes(kinematics.shape_space, self.shape)
        identity = torch.eye(3, dtype=camera.rotation.dtype, device=camera.rotation.device)
        self._camera_is_world = bool((camera.rotation == identity).all() and (camera.translation == 0).all())

    @property
    def is_orthographic(self) -> bool:
        return self.camera.kind == "orthographic"

    @own_precision
    def frames(self, pose: Float[Tensor, "*batch 36"], root_reference: Float[Tensor, "3 3"]) -> HandFrames:
        """Bones and keypoints in the world."""
        return self.kinematics(pose, self.shape, root_reference=root_reference)

    @own_precision
    def primitives_cam(self, frames: HandFrames) -> Primitives:
        """The 37 quadrics in the camera frame."""
        placed = place_primitives(frames, self.sizes, is_left=self.kinematics.side == "left")
        return (
            placed
            if self._camera_is_world
            else placed.moved(self.camera.rotation.to(placed.position), self.camera.translation.to(placed.position))
        )

    @own_precision
    def outline_px(
        self, pose: Float[Tensor, "*batch 36"], root_reference: Float[Tensor, "3 3"], table: OutlineTable
    ) -> Float[Tensor, "*batch points 2"]:
        """Outline points of the table in pixels for a batch of poses; no visibility."""
        primitives = self.primitives_cam(self.frames(pose, root_reference))
        cones, arcs = generators(primitives, is_orthographic=self.is_orthographic, with_normals=False)
        return batch_first(self._pixels(sample_generators(cones, arcs, table)), pose.shape[:-1])

    def _pixels(self, points_cam: Float[Tensor, "points 3 n"]) -> Float[Tensor, "points 2 n"]:
        """Pixels of points in the camera frame, the batch last throughout."""
        camera = self.camera
        if camera.has_distortion or camera.has_skew:
            return camera.pixels_from_plane(camera.plane_from_cam(points_cam.mT)).mT
        x, y, z = points_cam.unbind(1)
        scale, centre = camera.intrinsics.diagonal()[:2], camera.intrinsics[:2, 2]
        if not self.is_orthographic:
            nearness = z.reciprocal()
            x, y = x * nearness, y * nearness
        pixels = (torch.addcmul(centre[i], scale[i], plane) for i, plane in enumerate((x, y)))
        return torch.stack(tuple(pixels), 1)

    @own_precision
    def contour(self, pose: Float[Tensor, "36"], root_reference: Float[Tensor, "3 3"], table: OutlineTable) -> Contour:
        """The reference contour of one pose, with normals and self-occlusion."""
        return self.contour_of(self.primitives_cam(self.frames(pose, root_reference)), table)

    def generators_of(self, primitives: Primitives) -> Generators:
        """Contour generators, with normals, of hands whose primitives in the camera frame are known."""
        return generators(primitives, is_orthographic=self.is_orthographic, with_normals=True)

    @own_precision
    def along_normals_px(
        self, primitives: Primitives, seen: Generators, table: OutlineTable, normals: Float[Tensor, "points 2"]
    ) -> Float[Tensor, "hands points"]:
        """normal · pixel of the outlines of a batch of hands, the one that the normals belong to first: what an edge
        search measures. primitives: in the camera frame; seen: their generators."""
        cones, arcs = seen
        own = sample_generators(cones.of_hand(0), arcs.of_hand(0), table)[..., 0]
        slope = self.camera.pixel_jacobian(self.camera.plane_from_cam(own))
        in_plane = (normals[:, None] @ slope.to(normals))[:, 0]
        points = farthest_along(cone_sections(primitives), arcs, table, in_plane, is_orthographic=self.is_orthographic)
        x, y = self._pixels(points).unbind(1)
        return torch.addcmul(x * normals[:, :1], y, normals[:, 1:]).T

    @own_precision
    def contour_of(
        self,
        primitives: Primitives,
        table: OutlineTable,
        known: Generators | None = None,
        visible: Bool[Tensor, "points"] | None = None,
    ) -> Contour:
        """The reference contour of one hand whose primitives in the camera frame are known.

        `known` are its generators, `visible` what is visible of it, where these have been computed before.
        """
        seen = outline_of(*(known or self.generators_of(primitives)), table, ())
        plane = self.camera.plane_from_cam(seen.points_cam)
        if visible is None:
            visible = visible_points(primitives, seen, table, is_orthographic=self.is_orthographic)
        return Contour(
            points_px=self.camera.pixels_from_plane(plane),
            normals=pixel_normals(self.camera, plane, seen.normals_cam),
            visible=visible & (seen.points_cam[..., 2] > 0),
        )

    @own_precision
    def silhouette(
        self, pose: Float[Tensor, "36"], root_reference: Float[Tensor, "3 3"]
    ) -> Bool[Tensor, "height width"]:
        """Filled union of the primitives' outlines: `raycast(...).mask` to half a pixel, in a millisecond or two.

        Each primitive is filled as the convex polygon of its outline; whole ellipsoids stand for the halves that close
        the palm and the fingertips, whose other half lies within the part they close.
        """
        with torch.no_grad():
            return self.silhouette_of(self.primitives_cam(self.frames(pose, root_reference)))

    @own_precision
    def silhouette_of(self, primitives: Primitives, known: Generators | None = None) -> Bool[Tensor, "height width"]:
        """`silhouette` of one hand whose primitives in the camera frame are known."""
        known = known or generators(primitives, is_orthographic=self.is_orthographic, with_normals=False)
        return self.filled(Polygons.of(known))

    def filled(self, polygons: "Polygons") -> Bool[Tensor, "height width"]:
        """`silhouette` of one hand whose polygons in the camera frame are known."""
        with torch.no_grad():
            points, is_real = polygons.corners, polygons.is_real.squeeze(-1)
            pixels = self._pixels(points).squeeze(-1)
            is_ahead = (points[:, 2] > 0).squeeze(-1)
            pixels, is_real, is_ahead = (x.cpu().numpy() for x in (pixels, is_real, is_ahead))
        canvas = np.zeros((self.camera.height, self.camera.width), dtype=np.uint8)
        count = 4 * len(CONE_NAMES)
        start = 0
        for corners, ahead in (
            (pixels[:count].reshape(-1, 4, 2), is_ahead[:count].reshape(-1, 4)),
            (pixels[count:].reshape(-1, _ARC_CORNERS, 2), is_ahead[count:].reshape(-1, _ARC_CORNERS)),
        ):
            keep = ahead.all(1) & is_real[start : start + len(corners)] & (np.abs(corners) < _FARTHEST_PX).all((1, 2))
            for polygon in np.rint(_inset(corners[keep]) * (1 << _SHIFT)).astype(np.int32):
                cv2.fillConvexPoly(canvas, polygon, 1, shift=_SHIFT)
            start += len(corners)
        return torch.from_numpy(canvas).view(torch.bool).to(points.device)


def _inset(polygons: np.ndarray) -> np.ndarray:
    """Convex polygons (n, corners, 2) with their sides moved inwards: OpenCV fills every pixel that an edge touches.

    Of four corners the two long sides move, of many every corner along its normal.
    """
    if polygons.shape[1] == 4:
        along = np.repeat(polygons[:, (1, 3)] - polygons[:, (0, 2)], 2, 1)
    else:
        along = np.roll(polygons, -1, 1) - np.roll(polygons, 1, 1)
    normal = np.stack((-along[..., 1], along[..., 0]), -1)
    length = np.hypot(along[..., 0], along[..., 1])[..., None]
    inwards = np.sign(((polygons.mean(1, keepdims=True) - polygons) * normal).sum(-1, keepdims=True))
    return polygons + _INSET_PX * inwards * normal / np.maximum(length, 1e-9)


@kept(8)
def _polygon_table(dtype: torch.dtype, device: torch.device) -> OutlineTable:
    """Corners of every primitive's outline in drawing order."""
    arcs = outline_table(1, _ARC_CORNERS, dtype=dtype)
    cones = torch.arange(len(CONE_NAMES))
    table = OutlineTable(
        cone=cones.repeat_interleave(4),
        cone_side=torch.tensor((0, 0, 1, 1)).repeat(len(cones)),
        cone_fraction=torch.tensor((0.0, 1.0, 1.0, 0.0), dtype=dtype).repeat(len(cones)),
        ellipsoid=arcs.ellipsoid,
        ellipsoid_fraction=arcs.ellipsoid_fraction,
    )
    return sent_to(table, device)
