"""How the outline of the primitives moves in the picture with the pose, in closed form.

A point of a contour generator is carried by its bone, and slides on the surface as the direction of view changes. The
slide is tangent to the surface, whose tangent plane holds the line of sight: in the picture it runs along the outline.
Across the outline the derivative is therefore that of the rigid motion alone, exactly; along it the slide is left out,
as distances from a contour hardly change that way.

A change of the residual per pixel is a force at the point; its wrench about the camera's centre, times the screws of
the joints before the point's bone, is the derivative: six numbers per point and per joint instead of a lever for each
pair.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandPose
from torchhand.view.contours.carried_parts import CarriedParts
from torchhand.view.contours.seen_bones import BonePlacer, SeenBones
from torchhand.view.contours.terms import PointToLineTerms
from torchhand.view.outlines import HandProjector, OutlineColumns, OutlineTable, PartOutlines

_MIN_DEPTH = 1e-3  # metres before the camera


@dataclass(frozen=True, kw_only=True)
class OutlineMotion:
    """Points of the outlines of a batch of hands in the picture, and how they move."""

    columns_px: Float[Tensor, "hands 2 points"]
    """The points; here and below a row for each coordinate, which is faster for many."""
    columns_cam: Float[Tensor, "hands 3 points"]
    """Points in the camera frame, metres; of points that are not before the camera, any that are."""
    columns_plane: Float[Tensor, "hands 2 points"]
    """Points on the normalised image plane."""
    screws: Float[Tensor, "hands 36 6"]
    """Screws of the DOFs: turn, then shift of the camera's centre."""
    camera: Camera
    outlines: PartOutlines
    carried: CarriedParts

    def slopes(self, direction: Float[Tensor, "hands terms 2 points"]) -> Float[Tensor, "hands terms points 36"]:
        """Derivative of direction · point in the DOFs, px per metre or radian, the direction held."""
        wrenches = self.outlines.split(self._wrenches(direction))
        moved = []
        for own, wrench in zip(self.carried.by_dof.T.split(self.outlines.counts), wrenches, strict=True):
            screws = own[:, :, None] * self.screws[:, None]  # hands, parts, 36, 6
            moved.append((wrench.mT @ screws[:, None].mT).flatten(2, 3))
        return torch.cat(moved, 2)

    def equations(self, terms: PointToLineTerms) -> tuple[Float[Tensor, "hands 36 36"], Float[Tensor, "hands 36"]]:
        """Second derivative (of Gauss and Newton) and first of the terms' cost in the DOFs."""
        wrench = self._wrenches(terms.direction)
        rows = torch.cat((wrench, wrench * terms.curvature[:, :, None], terms.gradient[:, :, None]), 2)
        parts = (part.contiguous() for part in self.outlines.split(rows))
        moments = [part[..., :6, :] @ part[..., 6:, :].mT for part in parts]
        return self.carried.equations(torch.cat(moments, 2).sum(1), self.screws)

    def _wrenches(self, direction: Float[Tensor, "hands terms 2 points"]) -> Float[Tensor, "hands terms 6 points"]:
        """About the camera's centre, of forces along the directions."""
        points = self.columns_cam[:, None]
        x, y, z = points.unbind(-2)
        fx, fy, fz = force = cam_force(self.camera, points, self.columns_plane[:, None], direction)
        return torch.stack((y * fz - z * fy, z * fx - x * fz, x * fy - y * fx, *force), 2)


def cam_force(
    camera: Camera,
    columns_cam: Float[Tensor, "*#batch 3 points"],
    columns_plane: Float[Tensor, "*#batch 2 points"],
    direction: Float[Tensor, "*batch 2 points"],
) -> tuple[Float[Tensor, "*batch points"], Float[Tensor, "*batch points"], Float[Tensor, "*batch points"]]:
    """Derivative of direction · pixel in the point, camera frame: px per metre, coordinate by coordinate."""
    if camera.has_distortion or camera.has_skew:
        slopes = camera.pixel_jacobian(columns_plane.mT)
        x, y = (direction.mT[..., None, :] @ slopes).squeeze(-2).unbind(-1)
    else:
        x, y = (direction * camera.intrinsics.diagonal()[:2, None]).unbind(-2)
    if camera.kind == "orthographic":
        return x, y, torch.zeros_like(x)
    u, v = columns_plane.unbind(-2)
    nearness = columns_cam[..., 2, :].reciprocal()
    x, y = x * nearness, y * nearness
    return x, y, -torch.addcmul(x * u, y, v)


class OutlineTracer:
    """Outlines of many hands with their motion, with all that does not change laid out once.

    table: part by part, with the same number of points on every cone that it has, and on every ellipsoid.
    """

    def __init__(self, projector: HandProjector, table: OutlineTable) -> None:
        kinematics, camera, like = projector.kinematics, projector.camera, projector.shape
        self.projector, self.table = projector, table
        self.outlines = PartOutlines(
            projector.sizes,
            table,
            is_left=kinematics.side == "left",
            is_orthographic=projector.is_orthographic,
        )
        self._placer = BonePlacer(kinematics, camera, projector.shape, like.dtype)
        self._carried = CarriedParts(kinematics, self.outlines.bones, like)
        self._focal, self._centre = camera.intrinsics.diagonal()[:2, None], camera.intrinsics[:2, 2:]
        self._ahead = like.new_tensor((0.0, 0.0, 1.0))[:, None]

    def __call__(self, pose: HandPose) -> OutlineMotion:
        """Motion of outlines of hands in the world; no visibility."""
        bones = self.place(pose)
        return self.motion(bones, self.outlines(self.outlines.placed(bones.cam_from_bone)))

    def points(self, pose: HandPose) -> Float[Tensor, "hands 2 points"]:
        """The points in the picture alone, px."""
        placed = self.outlines.placed(self.place(pose).cam_from_bone)
        return self._projected(self.outlines(placed).points)[0]

    def place(self, pose: HandPose) -> SeenBones:
        """The bones before the camera."""
        return self._placer(pose.dofs, pose.reference)

    def motion(self, bones: SeenBones, outline: OutlineColumns) -> OutlineMotion:
        """Motion of an outline that is known."""
        columns_px, points, plane = self._projected(outline.points)
        return OutlineMotion(
            columns_px=columns_px,
            columns_cam=points,
            columns_plane=plane,
            screws=bones.screws,
            camera=self.projector.camera,
            outlines=self.outlines,
            carried=self._carried,
        )

    def _projected(
        self, points: Float[Tensor, "hands 3 points"]
    ) -> tuple[Float[Tensor, "hands 2 points"], Float[Tensor, "hands 3 points"], Float[Tensor, "hands 2 points"]]:
        """Pixels, points in space that lie before the camera, and where they are on the normalised image plane."""
        camera = self.projector.camera
        is_behind = points[:, 2:] < _MIN_DEPTH  # must not become infinite
        points = torch.where(is_behind, self._ahead, points)
        plane = points[:, :2] if self.projector.is_orthographic else points[:, :2] / points[:, 2:]
        if camera.has_distortion or camera.has_skew:
            return camera.pixels_from_plane(plane.mT).mT, points, plane
        return torch.addcmul(self._centre, plane, self._focal), points, plane
