"""The edge of a silhouette as a measurement of an open hand: edges along the normals of the model's contour."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import sent_to
from torchhand.fit.contour import hand_length_px, is_outer
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.image import EdgeSettings, search_edges
from torchhand.view import OutlineTable, outline_table

_POINTS_PER_GENERATOR, _POINTS_PER_ARC = 10, 8  # on each straight side of a primitive and on each round end
_MIN_POINTS = 30
_REACH, _MIN_REACH_PX = 0.03, 4.0  # how far from the contour edges are looked for, fraction of the hand's length
_GROSS = 0.3  # fraction of this reach beyond which an edge counts as another part's
_STD = 0.005  # standard deviation of an edge, fraction of the hand's length: surfaces differ, and neighbours alike
_FROM_MASK = EdgeSettings(polarity="inside_bright", min_strength=0.15, choose="nearest")


@dataclass(frozen=True, kw_only=True)
class OutlineEdges:
    """Edges of a silhouette, each matched with a point of the model's outer contour."""

    problem: OpenHandProblem
    table: OutlineTable
    """The points of the contour."""
    edges_px: Float[Tensor, "points 2"]
    normals: Float[Tensor, "points 2"]
    weight: Float[Tensor, "points"]
    """Inverse variance of each edge along its normal, px⁻²; 0 where none was found."""
    residual_px: float
    """Median absolute distance of the found edges from the contour; infinite without edges."""
    found_fraction: float
    """Fraction of the visible outer contour points at which an edge was found."""

    def residuals(self, values: Float[Tensor, "hands n"]) -> Float[Tensor, "hands points"]:
        """Distances of the edges from the same points of other hands' contours, in standard deviations."""
        projector, poses = self.problem.projected(values)
        points = projector.outline_px(poses, self.problem.root_reference, self.table)
        return self.weight.sqrt() * ((self.edges_px - points) * self.normals).sum(-1)


def match_edges(
    plane: Float[Tensor, "height width"], problem: OpenHandProblem, values: Float[Tensor, "n"]
) -> OutlineEdges | None:
    """Edges along the normals of the model's outer contour; None where hardly any contour is visible.

    `plane` is the silhouette, smoothed, 1 inside. The picture's own edges would be sharper, but limbs are shaded: they
    lie up to half a pixel inside.
    """
    projector, pose = problem.projected(values)
    table = sent_to(outline_table(_POINTS_PER_GENERATOR, _POINTS_PER_ARC, without=("palm_wrist",)), values.device)
    contour = projector.contour(pose, problem.root_reference, table)
    length_px = hand_length_px(problem.camera, problem.kinematics, pose, projector.shape)
    silhouette = projector.silhouette(pose, problem.root_reference)
    keep = contour.visible & is_outer(silhouette, contour.points_px, contour.normals, length_px)
    if int(keep.sum()) < _MIN_POINTS:
        return None
    points, normals = contour.points_px[keep], contour.normals[keep]
    reach_px = max(_REACH * length_px, _MIN_REACH_PX)
    search = torch.full_like(points[:, 0], reach_px)
    seen = search_edges(plane, points, normals, _FROM_MASK, half_length_px=search)
    trust = (1 + (seen.offset_px / (_GROSS * reach_px)) ** 2) ** -2 / seen.candidates.clamp_min(1)
    return OutlineEdges(
        problem=problem,
        table=table.select(keep),
        edges_px=points + seen.offset_px[:, None] * normals,
        normals=normals,
        weight=seen.found * trust / (_STD * length_px) ** 2,
        residual_px=float(seen.offset_px[seen.found].abs().median()) if bool(seen.found.any()) else float("inf"),
        found_fraction=float(seen.found.double().mean()),
    )
