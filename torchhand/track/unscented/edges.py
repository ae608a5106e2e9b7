"""Edges along the normals of a contour, in one view: what the sigma points' contours are compared with."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.contour import is_in_picture, is_outer
from torchhand.geometry import Camera
from torchhand.hand import HandFrames
from torchhand.image import EdgeSettings, search_edges
from torchhand.track.unscented.settings import UnscentedUpdateSettings
from torchhand.view import HandProjector, OutlineTable

_MIN_POINTS = 10
_SURFACE_STD = 0.01
"""Standard deviation of the model's surface, hand lengths: an error that all edges on one bone have in common, and that
counts where detected keypoints tell of the posture too."""
_MIN_SEARCH_PX = 4.0
_WIDENING = 0.5  # the search grows by this share with every failed frame
_INNER_REACH = 0.6  # half length of the search for inner edges over that for outer ones


@dataclass(frozen=True, kw_only=True)
class Planes:
    """The pictures of one view in which edges are searched, 0..1."""

    outer: Float[Tensor, "height width"]
    """Picture for the edges of the silhouette."""
    inner: Float[Tensor, "height width"] | None
    """Picture for the edges of parts of the hand before others; None leaves those out."""


@dataclass(frozen=True, kw_only=True)
class ContourVisibility:
    """Which points of a contour the camera sees, and which of these lie on the silhouette."""

    visible: Bool[Tensor, "points"]
    outer: Bool[Tensor, "visible_points"]
    seen: OutlineTable
    """The visible points in the table of all."""


@dataclass(frozen=True, kw_only=True)
class EdgeMeasurement:
    """Edges found in one view, as measurements of the contour's points along its normals, px."""

    predicted: Float[Tensor, "sigma points"]
    """Predictions of every sigma point's hand."""
    value: Float[Tensor, "points"]
    variance: Float[Tensor, "points"]
    is_found: Bool[Tensor, "points"]
    surface_variance: Float[Tensor, "points"]
    """Of the error of the model's surface, which all edges on one primitive have in common, as if it were each edge's
    own: that variance times their number."""
    visibility: ContourVisibility
    """Visibility of the points, for a further pass over the same picture, which does not evaluate it again."""
    in_picture: Bool[Tensor, "points"]

    @property
    def outer_in_picture(self) -> int:
        """Points of the outer contour in the picture."""
        return int((self.visibility.outer & self.in_picture).sum())


@dataclass(frozen=True, kw_only=True)
class EdgeSearch:
    """Searches the edges of one view."""

    settings: UnscentedUpdateSettings
    table: OutlineTable

    def __call__(
        self,
        projector: HandProjector,
        frames: HandFrames,
        planes: Planes,
        failures: int,
        before: ContourVisibility | None,
    ) -> EdgeMeasurement | None:
        """frames: of the sigma points' hands in the world, the reference hand first. None where fewer than ten visible
        contour points lie in the picture."""
        camera = projector.camera
        hands = projector.primitives_cam(frames)
        cones, arcs = projector.generators_of(hands)
        reference = replace(hands, rotation=hands.rotation[0], position=hands.position[0])
        own = (cones.of_hand(0), arcs.of_hand(0))
        contour = projector.contour_of(reference, self.table, own, before.visible if before else None)
        shown = contour.visible.nonzero().squeeze(-1)
        points, normals = contour.points_px.index_select(0, shown), contour.normals.index_select(0, shown)
        in_picture = is_in_picture(points, camera)
        if int(in_picture.sum()) < _MIN_POINTS:
            return None
        length_px = length_in_picture(projector, frames.position[0, 0])
        if before is None:
            outer = is_outer(projector.silhouette_of(reference, own), points, normals, length_px)
        else:
            outer = before.outer
        offset, is_found, variance = self._searched(points, normals, outer, planes, length_px, failures)
        is_same = before is not None and torch.equal(before.visible, contour.visible)
        seen = before.seen if before is not None and is_same else self.table.select(contour.visible)
        together = torch.bincount(seen.primitive, weights=is_found.to(offset))[seen.primitive]
        surface_px = _SURFACE_STD * length_px
        return EdgeMeasurement(
            predicted=projector.along_normals_px(hands, (cones, arcs), seen, normals),
            surface_variance=together * surface_px**2,
            value=(points * normals).sum(-1) + offset,
            variance=variance,
            is_found=is_found,
            visibility=ContourVisibility(visible=contour.visible, outer=outer, seen=seen),
            in_picture=in_picture,
        )

    def _searched(
        self, points: Tensor, normals: Tensor, outer: Tensor, planes: Planes, length_px: float, failures: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Offsets along the normals, where an edge was found, and variances: an edge among rivals deserves less
        trust."""
        s = self.settings
        reach_px = max(_MIN_SEARCH_PX, s.search_fraction * length_px) * (1 + _WIDENING * failures)
        offset, is_found = torch.zeros_like(points[:, 0]), torch.zeros_like(outer)
        rivals, weight = torch.ones_like(outer, dtype=torch.long), torch.ones_like(offset)
        searches: list[tuple[Tensor, Tensor, EdgeSettings, float, float]] = [
            (outer, planes.outer, s.outer_edges, reach_px, 1.0)
        ]
        if planes.inner is not None:
            searches.append((~outer, planes.inner, s.inner_edges, _INNER_REACH * reach_px, s.inner_weight))
        for which, plane, how, half_length_px, fraction in searches:
            rows = which.nonzero().squeeze(-1)
            if len(rows):
                own = (points.index_select(0, rows), normals.index_select(0, rows))
                edges = search_edges(plane, *own, how, half_length_px=half_length_px)
                offset.index_copy_(0, rows, edges.offset_px)
                is_found.index_copy_(0, rows, edges.found)
                rivals.index_copy_(0, rows, edges.candidates)
                weight.index_fill_(0, rows, fraction)
        return offset, is_found, s.edge_std_px**2 * rivals.clamp_min(1) / weight


def length_in_picture(projector: HandProjector, root_world: Float[Tensor, "3"]) -> float:
    """Pixels of a hand held parallel to the picture at the root's depth."""
    camera: Camera = projector.camera
    focal_px = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    length = float(projector.shape[projector.kinematics.shape_space.names.index("hand_length")])
    if camera.kind != "pinhole":
        return focal_px * length
    return focal_px * length / max(float(camera.cam_from_world(root_world)[2]), 1e-3)
