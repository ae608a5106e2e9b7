"""Occluding contours of a batch of hands: decided upon at some poses, then followed while the hands move.

What depends on the whole hand would make a cost jump: which points are visible, whether the picture shows background
beyond them (outer) or more of the hand (inner), and their normals. It is decided once (`VisibleContour`), and the
points then move with the pose until it is decided anew. There are two surfaces: the primitives, whose contours are
closed forms at fixed parameters (Stenger et al. 2001), and the skinned mesh, with the edges between faces turned to the
camera and faces turned away, visible in a z-buffer (Ouhaddi and Horain 1998, section 7.2).
"""

from dataclasses import dataclass, fields
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.geometry import Camera
from torchhand.hand import BONES, HandKinematics, HandPose, ShapeSpace
from torchhand.precision import own_precision
from torchhand.view.contours.jacobian import OutlineTracer
from torchhand.view.contours.terms import PointToLineTerms
from torchhand.view.outlines import HandProjector, OutlineTable, lengths_along, pixel_normals, seen_and_outer

_MIN_DEPTH = 1e-3  # metres before the camera
_SHAPE_STEP = 1e-5  # of a finite difference, standard deviations of the population
_WRIST, _MIDDLE_PROXIMAL = BONES.index("wrist"), BONES.index("middle_proximal")


@runtime_checkable
class ContourMotion(Protocol):
    """Where the points of the contours of some hands are in the picture, and how they move with the pose."""

    @property
    def columns_px(self) -> Float[Tensor, "hands 2 points"]: ...

    def slopes(self, direction: Float[Tensor, "hands terms 2 points"]) -> Float[Tensor, "hands terms points 36"]:
        """Derivative of direction · point in the DOFs, px per metre or radian, the direction held."""
        ...

    def equations(self, terms: PointToLineTerms) -> tuple[Float[Tensor, "hands 36 36"], Float[Tensor, "hands 36"]]:
        """Second derivative (of Gauss and Newton) and first of the terms' cost in the DOFs."""
        ...


@dataclass(frozen=True, kw_only=True)
class VisibleContour:
    """What is decided about the contours of some hands at their poses; a row per hand."""

    points_px: Float[Tensor, "hands points 2"]
    normals: Float[Tensor, "hands points 2"]
    """Outward unit normals."""
    outer: Bool[Tensor, "hands points"]
    """Visible, with background beyond."""
    inner: Bool[Tensor, "hands points"]
    """Visible, with more of the hand beyond."""
    length_px: Float[Tensor, "hands points"]
    """Length of outline that each point stands for, px; points are not evenly spread."""
    wrist_px: Float[Tensor, "hands 2"]
    distal_px: Float[Tensor, "hands 2"]
    """Direction in the picture from the wrist to the middle finger's knuckle."""
    edges: Int[Tensor, "hands points 2"] | None = None
    """Edges of a mesh: the vertices at the ends of each point's edge."""
    motion: ContourMotion | None = None
    """Motion of the points at these poses, where it is known."""

    def rows(self, rows: Int[Tensor, "k"]) -> "VisibleContour":
        """The rows of some of the hands, without their motion."""

        def own(name: str) -> Any:
            value = getattr(self, name)
            return value[rows] if isinstance(value, Tensor) else None

        return VisibleContour(**{f.name: own(f.name) for f in fields(self)})


@runtime_checkable
class Contours(Protocol):
    """A surface of one shape before one camera, whose contours can be followed."""

    @property
    def kinematics(self) -> HandKinematics: ...

    @property
    def camera(self) -> Camera: ...

    @property
    def shape(self) -> Float[Tensor, "shape"]: ...

    def with_shape(self, shape: Float[Tensor, "shape"]) -> "Contours":
        """The contours of a hand of another shape."""
        ...

    def thinned(self, factor: int) -> "Contours":
        """The contours with one point in place of so many; itself for 1. Made once."""
        ...

    def visible(self, pose: HandPose, *, probe_distance_px: float | Float[Tensor, "hands"] = 1.0) -> VisibleContour:
        """Contours at the poses (hands). probe_distance_px: how far outside a point the picture is asked for the
        hand."""
        ...

    def points(self, pose: HandPose, visible: VisibleContour) -> Float[Tensor, "hands 2 points"]:
        """The points that `visible` decides about, px, wherever the hands have moved since."""
        ...

    def motion(self, pose: HandPose, visible: VisibleContour) -> ContourMotion:
        """The same points with their motion."""
        ...

    def shape_slopes(
        self, pose: HandPose, visible: VisibleContour, columns: tuple[int, ...]
    ) -> Float[Tensor, "hands 2 points columns"]:
        """Derivative of the same points in some parameters of the shape, px; by finite differences. Only across the
        outline, along which points may slide, is it that of the outline."""
        ...


class PrimitiveContours:
    """Contours of the 37 quadrics; `table` as for `OutlineTracer`."""

    def __init__(self, projector: HandProjector, table: OutlineTable) -> None:
        self.projector = projector
        with torch.inference_mode(False):  # what is kept is for callers in any mode
            self._tracer = OutlineTracer(projector, table)
        self._thinned: dict[int, PrimitiveContours] = {1: self}

    @property
    def kinematics(self) -> HandKinematics:
        return self.projector.kinematics

    @property
    def camera(self) -> Camera:
        return self.projector.camera

    @property
    def shape(self) -> Float[Tensor, "shape"]:
        return self.projector.shape

    def with_shape(self, shape: Float[Tensor, "shape"]) -> "PrimitiveContours":
        """The contours of a hand of another shape."""
        return PrimitiveContours(HandProjector(self.kinematics, self.camera, shape), self._tracer.table)

    def thinned(self, factor: int) -> "PrimitiveContours":
        """The contours with one point in place of so many; itself for 1. Made once."""
        if factor not in self._thinned:
            with torch.inference_mode(False):  # kept for callers in any mode
                self._thinned[factor] = PrimitiveContours(self.projector, self._tracer.table.thinned(factor))
        return self._thinned[factor]

    @own_precision
    def visible(self, pose: HandPose, *, probe_distance_px: float | Float[Tensor, "hands"] = 1.0) -> VisibleContour:
        """Contours at the poses (hands). probe_distance_px: how far outside a point the picture is asked for the
        hand."""
        tracer, camera = self._tracer, self.camera
        bones = tracer.place(pose)
        placed = tracer.outlines.placed(bones.cam_from_bone)
        outline = tracer.outlines(placed, with_normals=True)
        motion = tracer.motion(bones, outline)
        assert outline.normals is not None
        assert outline.is_real is not None
        normals = pixel_normals(camera, motion.columns_plane.mT, outline.normals.mT)
        is_real = outline.is_real & (outline.points[:, 2] > _MIN_DEPTH) & motion.columns_px.isfinite().all(1)
        probes = motion.columns_px.mT + _each_hand(probe_distance_px) * normals
        visible, outer = seen_and_outer(
            tracer.outlines.quadrics(placed),
            motion.columns_cam,
            camera.plane_from_pixels(probes).mT,
            tracer.table,
            is_real,
            is_orthographic=self.projector.is_orthographic,
        )
        ends = constant_tensor((_WRIST, _MIDDLE_PROXIMAL), torch.long, normals.device)
        wrist, distal = wrist_and_axis(bones.cam_from_bone[..., 3].index_select(1, ends), camera)
        return VisibleContour(
            points_px=motion.columns_px.mT,
            normals=normals,
            outer=visible & outer,
            inner=visible & ~outer,
            length_px=lengths_along(motion.columns_px, tracer.table),
            wrist_px=wrist,
            distal_px=distal,
            motion=motion,
        )

    @own_precision
    def points(self, pose: HandPose, visible: VisibleContour) -> Float[Tensor, "hands 2 points"]:
        """The points that `visible` decides about, px, wherever the hands have moved since."""
        return self._tracer.points(pose)

    @own_precision
    def motion(self, pose: HandPose, visible: VisibleContour) -> ContourMotion:
        """The same points with their motion."""
        return self._tracer(pose)

    @own_precision
    def shape_slopes(
        self, pose: HandPose, visible: VisibleContour, columns: tuple[int, ...]
    ) -> Float[Tensor, "hands 2 points columns"]:
        """Derivative of the same points in some parameters of the shape, px; by finite differences, of all parameters
        at once. Only across the outline, along which points may slide, is it that of the outline."""
        shapes, steps = varied_shapes(self.kinematics.shape_space, self.shape, columns)
        projector, table = HandProjector(self.kinematics, self.camera, shapes), self._tracer.table
        hands = zip(pose.dofs, pose.reference, strict=True)
        points = torch.stack([projector.outline_px(dofs.expand(len(shapes), -1), at, table) for dofs, at in hands])
        return ((points[:, 1:] - points[:, :1]) / steps[:, None, None]).permute(0, 3, 2, 1)


def varied_shapes(
    space: ShapeSpace, shape: Float[Tensor, "shape"], columns: tuple[int, ...]
) -> tuple[Float[Tensor, "varied shape"], Float[Tensor, "columns"]]:
    """A shape, and the shapes that differ from it by a small step in one of some parameters each; and these steps."""
    places = constant_tensor(columns, torch.long, shape.device)
    steps = _SHAPE_STEP * space.std.to(shape)[places]
    varied = shape.expand(len(columns), -1) + torch.zeros_like(shape).index_copy(0, places, steps).diag()[places]
    return torch.cat((shape[None], varied)), steps


def wrist_and_axis(
    places_cam: Float[Tensor, "hands 2 3"], camera: Camera
) -> tuple[Float[Tensor, "hands 2"], Float[Tensor, "hands 2"]]:
    """The wrist in the picture, and the way from there to the middle finger's knuckle; both given in space."""
    ends = camera.pixels_from_plane(camera.plane_from_cam(places_cam))
    return ends[:, 0], ends[:, 1] - ends[:, 0]


def _each_hand(length: float | Float[Tensor, "hands"]) -> "float | Float[Tensor, 'hands 1 1']":
    return length[:, None, None] if isinstance(length, Tensor) else length
