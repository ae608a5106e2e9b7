"""Edges along the normals of the model's outer contour as an observation (Stenger et al. 2001, section 4.3)."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import read_back
from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.fit.contour.equations import MovingContour, contours_of
from torchhand.fit.contour.points import pixels_per_metre
from torchhand.image import EdgeSettings, search_edges
from torchhand.view import Contours, VisibleContour
from torchhand.view.contours import PointToLineTerms

EDGES = "edges"
EDGE_REACH = 1 / 0.3
"""Half length of the search over the distance at which an edge is gross: that of another finger."""
_PROBE_M = 0.00374  # distance outside a point at which the hand must have ended for the point to be an outer one
_MIN_POINTS = 10  # of the outer contour, below which nothing is compared
_MIN_REACH_PX = 4.0  # half length of the search
_MIN_GROSS_PX = 2.0
_FROM_MASK = EdgeSettings(polarity="inside_bright", min_strength=0.15, choose="nearest")


@dataclass(frozen=True, kw_only=True)
class EdgeObservation:
    """The edges of one camera's silhouette, searched from where the model's outer contour lies."""

    plane: Float[Tensor, "height width"]
    """Silhouette, smoothed: 0 outside, 1 inside. The picture's own edges would be sharper, but limbs are shaded: they
    lie up to half a pixel inside."""
    contours: Contours
    """Contours of the surface to fit before this camera, remade where the hand's shape is another than theirs."""
    std_px: float = 0.0
    """Standard deviation of an edge, px; 0 or more."""
    std_m: float = 0.0
    """Standard deviation of the surface, metres at the hand; 0 or more, and not 0 beside an edge's of 0."""
    view: int = 0

    @property
    def is_empty(self) -> bool:
        return self._is_empty

    @cached_property
    def _is_empty(self) -> bool:
        return not bool(read_back(self.plane.any()))

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "EdgeObservation":
        """This observation itself, which all hypotheses have in common."""
        return self

    def associate(self, hands: PosedHands, stage: Stage) -> "EdgeFactor":
        """The nearest edge to every visible point of the outer contour; searched the farther, the coarser the stage.
        Among rivals an edge deserves less trust."""
        surface = self.contours.thinned(stage.thinning)
        contours = contours_of(surface, hands.shape, hands)
        px_per_m = pixels_per_metre(contours.camera, hands.pose)
        reach_px = (EDGE_REACH * stage.gross_m * px_per_m).clamp_min(_MIN_REACH_PX)
        visible = contours.visible(hands.pose, probe_distance_px=1 + _PROBE_M * px_per_m)
        outer = visible.outer & (visible.outer.sum(-1, keepdim=True) >= _MIN_POINTS)
        return EdgeFactor(
            contours=surface,
            visible=visible,
            associated=hands,
            outer=outer,
            **self._searched(visible, outer, reach_px, px_per_m),
            gross_px=(reach_px / EDGE_REACH).clamp_min(_MIN_GROSS_PX),
            view=self.view,
        )

    def _searched(
        self,
        visible: VisibleContour,
        outer: Bool[Tensor, "k points"],
        reach_px: Float[Tensor, "k"],
        px_per_m: Float[Tensor, "k"],
    ) -> dict[str, Tensor]:
        """Which outer points have an edge, its offset and weight. An accelerator is waited for here, once for each
        association: which points are searched, and how far, must be known before."""
        chosen = outer.flatten().nonzero().squeeze(-1)
        hand = chosen // outer.shape[1]
        seen = search_edges(
            self.plane,
            visible.points_px.flatten(0, 1)[chosen],
            visible.normals.flatten(0, 1)[chosen],
            _FROM_MASK,
            half_length_px=reach_px[hand],
        )
        variance = self.std_px**2 + (self.std_m * px_per_m[hand]).square()
        found = {
            "found": seen.found,
            "offset_px": seen.offset_px,
            "weight": 1 / (variance * seen.candidates.clamp_min(1)),
        }
        return {
            name: own.new_zeros(outer.numel()).index_copy(0, chosen, own).reshape(outer.shape)
            for name, own in found.items()
        }


@dataclass(frozen=True, kw_only=True)
class EdgeFactor:
    """½ Σ weight r² / (1 + r² / gross²) of the distances r of the edges from the contour (Geman and McClure); a row per
    hand. A point without an edge costs as much as one whose edge is infinitely far, wherever it goes."""

    contours: Contours
    visible: VisibleContour
    associated: PosedHands | None
    """The hands that data were associated with, whose motion may be known."""
    outer: Bool[Tensor, "k points"]
    """Points of the outer contour, where enough of it is visible."""
    found: Bool[Tensor, "k points"]
    offset_px: Float[Tensor, "k points"]
    """How far along its normal the edge of each point lay from it when they were associated."""
    weight: Float[Tensor, "k points"]
    """Inverse variances, px⁻²; 0 off the outer contour."""
    gross_px: Float[Tensor, "k"]
    view: int

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the DOFs, and in the shape where it is unknown."""
        moving = MovingContour.of(self.contours, self.visible, hands, self.associated)
        normals, sharpness = self.visible.normals.mT, self.gross_px[:, None].square().reciprocal()
        moved = (normals * (moving.motion.columns_px - self.visible.points_px.mT)).sum(1)
        residual = torch.where(self.found, moved - self.offset_px, 0.0)
        robust = (1 + residual.square() * sharpness).reciprocal()
        saturated = torch.where(self.found, residual.square() * robust, 1 / sharpness)
        curvature = torch.where(self.found, self.weight * robust.square(), 0.0)
        terms = PointToLineTerms(
            direction=torch.where(self.found[:, None], normals, 0.0)[:, None],
            curvature=curvature[:, None],
            gradient=(curvature * residual)[:, None],
        )
        return moving.equations(terms, 0.5 * (self.weight * saturated).sum(-1))

    def rows(self, rows: Int[Tensor, "n"]) -> "EdgeFactor":
        """The rows of some of the hands."""
        own = {name: getattr(self, name)[rows] for name in ("outer", "found", "offset_px", "weight", "gross_px")}
        return replace(self, visible=self.visible.rows(rows), associated=None, **own)

    def explained(self) -> tuple[Explained, ...]:
        """How much of the model's outer contour lies on edges; infinitely far where there are none."""
        offset, count = torch.where(self.found, self.offset_px.abs(), 0.0), self.found.sum(-1)
        mean = torch.minimum(offset, self.gross_px[:, None]).sum(-1) / count.clamp_min(1)
        return (
            Explained(
                name=EDGES,
                view=self.view,
                fraction=count / self.outer.sum(-1).clamp_min(1),
                distance=torch.where(count > 0, mean, torch.inf),
            ),
        )
