"""Occluding contours of a batch of hands for registration: looked at once, then followed while the hands move.

A look settles what depends on the whole hand and would make a cost jump: which points are visible, whether the picture
shows background beyond them (outer) or more of the hand (inner), and their normals. The points then move with the pose
until the next look. Two surfaces can be looked at: the primitives, whose contours are closed forms at fixed parameters
(paper 003), and the skinned mesh, with the edges between faces turned to the camera and faces turned away, visible in a
z-buffer (paper 000, section 7.2).
"""

from dataclasses import dataclass, fields
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import BONES, HandKinematics
from torchhand.view.contours.jacobian import OutlineTracer
from torchhand.view.contours.springs import Springs
from torchhand.view.outlines import HandProjector, OutlineTable, pixel_normals, seen_and_outer

_NEAREST = 1e-3  # metres before the camera
_WRIST, _MIDDLE_PROXIMAL = BONES.index("wrist"), BONES.index("middle_proximal")


@runtime_checkable
class ContourMotion(Protocol):
    """Where the points of contours are, and how they move."""

    @property
    def points_px(self) -> Float[Tensor, "hands points 2"]: ...

    def along(self, direction: Float[Tensor, "hands points 2"]) -> Float[Tensor, "hands points free"]:
        """Derivative of direction · point in the free parameters, px per unit, the direction held."""
        ...


@runtime_checkable
class HandContourMotion(ContourMotion, Protocol):
    """Contours of hands: also what springs at their points pull them to."""

    @property
    def columns_px(self) -> Float[Tensor, "hands 2 points"]: ...

    def equations(self, springs: Springs) -> tuple[Float[Tensor, "hands 36 36"], Float[Tensor, "hands 36"]]:
        """Second derivative (of Gauss and Newton) and first of the springs' cost in the DOFs, all of them moving."""
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
    motion: HandContourMotion | None = None
    """At the pose that was looked at, where it is known, every DOF moving."""

    def rows(self, rows: Int[Tensor, "k"]) -> "ContourLook":
        """The given hands, without their motion."""

        def own(name: str) -> Any:
            value = getattr(self, name)
            return value[rows] if isinstance(value, Tensor) else None

        return ContourLook(**{f.name: own(f.name) for f in fields(self)})


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
    ) -> HandContourMotion:
        """The points that were looked at, wherever the hands have moved since. moving: DOFs that are not held."""
        ...


class PrimitiveContours:
    """Contours of the 37 quadrics; `table` and `basis` as for `OutlineTracer`."""

    def __init__(self, projector: HandProjector, table: OutlineTable, basis: Float[Tensor, "36 free"]) -> None:
        self.projector = projector
        with torch.inference_mode(False):  # what is kept is for callers in any mode
            self._tracer = OutlineTracer(projector, table, basis)

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
        tracer, camera = self._tracer, self.camera
        bones = tracer.place(pose, root_reference)
        placed = tracer.outlines.placed(bones.cam_from_bone)
        outline = tracer.outlines(placed, with_normals=True)
        motion = tracer.motion(bones, outline)
        assert outline.normals is not None
        assert outline.is_real is not None
        normals = pixel_normals(camera, motion.columns_plane.mT, outline.normals.mT)
        is_real = outline.is_real & (outline.points[:, 2] > _NEAREST) & motion.columns_px.isfinite().all(1)
        visible, outer = seen_and_outer(
            tracer.outlines.quadrics(placed),
            motion.columns_cam,
            camera.plane_from_pixels(motion.points_px + beyond_px * normals).mT,
            tracer.table,
            is_real,
            is_orthographic=self.projector.is_orthographic,
        )
        wrist, fingerwards = wrist_and_axis(bones.cam_from_bone[:, (_WRIST, _MIDDLE_PROXIMAL), :, 3], camera)
        return ContourLook(
            points_px=motion.points_px,
            normals=normals,
            outer=visible & outer,
            inner=visible & ~outer,
            wrist_px=wrist,
            fingerwards_px=fingerwards,
            motion=motion,
        )

    def motion(
        self,
        pose: Float[Tensor, "hands 36"],
        root_reference: Float[Tensor, "hands 3 3"],
        look: ContourLook,
        moving: Bool[Tensor, "hands 36"] | None = None,
    ) -> HandContourMotion:
        """The points that were looked at, wherever the hands have moved since. moving: DOFs that are not held."""
        return self._tracer(pose, root_reference, moving)


def wrist_and_axis(
    places_cam: Float[Tensor, "hands 2 3"], camera: Camera
) -> tuple[Float[Tensor, "hands 2"], Float[Tensor, "hands 2"]]:
    """The wrist in the picture, and the way from there to the middle finger's knuckle; both given in space."""
    ends = camera.pixels_from_plane(camera.plane_from_cam(places_cam))
    return ends[:, 0], ends[:, 1] - ends[:, 0]
