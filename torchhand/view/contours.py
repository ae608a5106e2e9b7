"""Occluding contours of a batch of hands for registration: looked at once, then followed while the hands move.

A look settles what depends on the whole hand and would make a cost jump: which points are visible, whether the picture
shows background beyond them (outer) or more of the hand (inner), and their normals. The points then move with the pose
until the next look. Two surfaces can be looked at: the primitives, whose contours are closed forms at fixed parameters
(paper 003), and the skinned mesh, with the edges between faces turned to the camera and faces turned away, visible in a
z-buffer (paper 000, section 7.2).
"""

from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandFrames, HandKinematics
from torchhand.view.contour_jacobian import OutlineTracer
from torchhand.view.outline import Outline, OutlineTable, outline_of, pixel_normals
from torchhand.view.projector import HandProjector
from torchhand.view.visibility import visible_points

_NEAREST = 1e-3  # metres before the camera
_FAR = 1e3  # metres: behind any hand
_WRIST, _MIDDLE = 0, 9  # keypoints


@runtime_checkable
class ContourMotion(Protocol):
    """Where the points of contours are, and how they move."""

    @property
    def points_px(self) -> Float[Tensor, "hands points 2"]: ...

    def along(self, direction: Float[Tensor, "hands points 2"]) -> Float[Tensor, "hands points free"]:
        """Derivative of direction · point in the free parameters, px per unit, the direction held."""
        ...


@dataclass(frozen=True, kw_only=True)
class ContourLook:
    """What one look at some hands settles; a row per hand."""

    points_px: Float[Tensor, "hands points 2"]
    normals: Float[Tensor, "hands points 2"]
    """Unit, outward."""
    outer: Bool[Tensor, "hands points"]
    """Visible, with background beyond."""
    inner: Bool[Tensor, "hands points"]
    """Visible, with more of the hand beyond."""
    wrist_px: Float[Tensor, "hands 2"]
    fingerwards_px: Float[Tensor, "hands 2"]
    """From the wrist to the middle finger's knuckle."""
    edges: Int[Tensor, "hands points 2"] | None = None
    """Of a mesh: the vertices at the ends of each point's edge."""

    def rows(self, rows: Int[Tensor, "k"]) -> "ContourLook":
        """The given hands."""
        values = {f.name: getattr(self, f.name)[rows] for f in fields(self) if getattr(self, f.name) is not None}
        return ContourLook(**values)


@runtime_checkable
class Contours(Protocol):
    """A surface whose contours can be looked at and followed."""

    @property
    def kinematics(self) -> HandKinematics: ...

    @property
    def camera(self) -> Camera: ...

    @property
    def shape(self) -> Float[Tensor, "shape"]: ...

    def look(
        self, pose: Float[Tensor, "hands 36"], root_reference: Float[Tensor, "hands 3 3"], *, beyond_px: float
    ) -> ContourLook:
        """beyond_px: how far outside a point the picture is asked for the hand."""
        ...

    def motion(
        self,
        pose: Float[Tensor, "hands 36"],
        root_reference: Float[Tensor, "hands 3 3"],
        look: ContourLook,
        moving: Bool[Tensor, "hands 36"] | None = None,
    ) -> ContourMotion:
        """The points that were looked at, wherever the hands have moved since. moving: DOFs that are not held."""
        ...


class PrimitiveContours:
    """Contours of the 37 quadrics; `table` and `basis` as for `OutlineTracer`."""

    def __init__(self, projector: HandProjector, table: OutlineTable, basis: Float[Tensor, "36 free"]) -> None:
        self.projector = projector
        sizes = projector.sizes  # what they keep is made here, not within somebody's inference mode
        _ = sizes.placement, sizes.mirrored_placement, sizes.form
        self._tracer = OutlineTracer(projector, table, basis)
        self._twice = OutlineTable(
            cone=table.cone.repeat(2),
            cone_side=table.cone_side.repeat(2),
            cone_fraction=table.cone_fraction.repeat(2),
            ellipsoid=table.ellipsoid.repeat(2),
            ellipsoid_fraction=table.ellipsoid_fraction.repeat(2),
        )

    @property
    def kinematics(self) -> HandKinematics:
        return self.projector.kinematics

    @property
    def camera(self) -> Camera:
        return self.projector.camera

    @property
    def shape(self) -> Float[Tensor, "shape"]:
        return self.projector.shape

    def look(
        self, pose: Float[Tensor, "hands 36"], root_reference: Float[Tensor, "hands 3 3"], *, beyond_px: float
    ) -> ContourLook:
        """beyond_px: how far outside a point the picture is asked for the hand."""
        projector, table, camera = self.projector, self._tracer.table, self.camera
        frames = projector.kinematics(pose, projector.shape, root_reference=root_reference)
        primitives = projector.primitives_cam(frames)
        seen = outline_of(*projector.generators_of(primitives), table, tuple(pose.shape[:-1]))
        plane = camera.plane_from_cam(seen.points_cam)
        points, normals = camera.pixels_from_plane(plane), pixel_normals(camera, plane, seen.normals_cam)
        # A point far behind the picture just outside the outline is seen where no other part is.
        plane = camera.plane_from_pixels(points + beyond_px * normals)
        ahead = torch.cat((plane, torch.ones_like(plane[..., :1])), -1)
        is_orthographic = projector.is_orthographic
        far = ahead * (ahead.new_tensor((1.0, 1.0, _FAR)) if is_orthographic else _FAR)
        is_real = seen.is_real & (seen.points_cam[..., 2] > _NEAREST) & points.isfinite().all(-1)
        both, shown = _side_by_side(seen.points_cam, far, table), _side_by_side(is_real, is_real, table)
        backdrop = Outline(points_cam=both, normals_cam=both, is_real=shown)
        is_free = visible_points(primitives, backdrop, self._twice, is_orthographic=is_orthographic)
        visible, outer = _apart(is_free, table)
        wrist, fingerwards = wrist_and_axis(frames, camera)
        return ContourLook(
            points_px=points,
            normals=normals,
            outer=visible & outer,
            inner=visible & ~outer,
            wrist_px=wrist,
            fingerwards_px=fingerwards,
        )

    def motion(
        self,
        pose: Float[Tensor, "hands 36"],
        root_reference: Float[Tensor, "hands 3 3"],
        look: ContourLook,
        moving: Bool[Tensor, "hands 36"] | None = None,
    ) -> ContourMotion:
        """The points that were looked at, wherever the hands have moved since. moving: DOFs that are not held."""
        return self._tracer(pose, root_reference, moving)


def _side_by_side(one: Tensor, other: Tensor, table: OutlineTable) -> Tensor:
    """Two sets of a table's points as those of a table with every point twice, cones first."""
    cut = len(table.cone)
    return torch.cat((one[:, :cut], other[:, :cut], one[:, cut:], other[:, cut:]), 1)


def _apart(both: Tensor, table: OutlineTable) -> tuple[Tensor, Tensor]:
    cones, balls = both.split((2 * len(table.cone), 2 * len(table.ellipsoid)), 1)
    (one, other), (one_ball, other_ball) = cones.chunk(2, 1), balls.chunk(2, 1)
    return torch.cat((one, one_ball), 1), torch.cat((other, other_ball), 1)


def wrist_and_axis(frames: HandFrames, camera: Camera) -> tuple[Float[Tensor, "hands 2"], Float[Tensor, "hands 2"]]:
    """The wrist in the picture, and the way from there to the middle finger's knuckle."""
    ends = camera.project(frames.keypoints[:, (_WRIST, _MIDDLE)])
    return ends[:, 0], ends[:, 1] - ends[:, 0]
