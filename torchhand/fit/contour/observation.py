"""The contours of one picture as an observation (Ouhaddi and Horain 1998, section 7.4), on distance maps.

Both sides count: the model's outline must lie on the picture's contour, and the picture's contour on the model's
outline; inner outlines are drawn to dark valleys nearby.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.fit.contour.correspondences import Correspondences, boundary_offset, contour_terms
from torchhand.fit.contour.equations import MovingContour, contours_of
from torchhand.fit.contour.matching import match_boundary
from torchhand.fit.contour.picture import PictureContours
from torchhand.fit.contour.points import pixels_per_metre
from torchhand.fit.contour.settings import ContourSettings
from torchhand.image import Boundary, DistanceField
from torchhand.view import Contours, VisibleContour

CONTOUR = "contour"
NEAR_M = 0.00374
"""Distance within which the picture's contour and the model's lie on each other, metres at the hand."""
VALLEY_GROSS_M = 0.0028
"""Distance beyond which a valley is not that of a model point, metres at the hand, where the stage is no narrower."""
TURN_M = 0.0224
"""Distance that a turn of the contour by one radian is worth in matching, metres at the hand."""
_STEEP = 0.15  # of the hand's length: a palm seen shorter than this has no direction in the picture


@dataclass(frozen=True, kw_only=True)
class ContourObservation:
    """What one camera's picture shows of the hand's contours."""

    picture: PictureContours
    contours: Contours
    """Contours of the surface to fit, primitives or mesh, before this camera. They are remade where the hand's shape is
    another than theirs."""
    settings: ContourSettings
    view: int = 0

    @property
    def is_empty(self) -> bool:
        return self.picture.is_empty

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "ContourObservation":
        """This observation itself, which all hypotheses have in common."""
        return self

    def associate(self, hands: PosedHands, stage: Stage) -> "ContourFactor":
        """Visible points of the model, and which of them belong to which points of the picture's contour."""
        s, picture, surface = self.settings, self.picture, self.contours.thinned(stage.thinning)
        contours = contours_of(surface, hands.shape, hands)
        px_per_m = pixels_per_metre(contours.camera, hands.pose)
        length_px = px_per_m * hands.shape[contours.kinematics.shape_space.names.index("hand_length")]
        field, gross_px = picture.field(stage.pitch_px), stage.gross_m * px_per_m
        boundary = picture.boundary.thinned(stage.thinning)
        visible = contours.visible(hands.pose, probe_distance_px=1 + s.probe_distance_m * px_per_m)
        match = match_boundary(boundary, visible.points_px, visible.normals, visible.outer, turn_px=TURN_M * px_per_m)
        pairs = Correspondences.of(
            visible,
            field.channels,
            boundary,
            match,
            self._weights(visible, boundary, gross_px, length_px),
            gross_px=gross_px,
            valley_gross_px=min(VALLEY_GROSS_M, stage.gross_m) * px_per_m,
            unmatched_px=length_px,
        )
        return ContourFactor(
            contours=surface,
            field=field,
            valleys=picture.valleys,
            visible=visible,
            pairs=pairs,
            associated=hands,
            gross_px=gross_px,
            near_px=NEAR_M * px_per_m,
            view=self.view,
        )

    def _weights(
        self,
        visible: VisibleContour,
        boundary: Boundary,
        gross_px: Float[Tensor, "hands"],
        length_px: Float[Tensor, "hands"],
    ) -> Float[Tensor, "hands terms"]:
        """Weights of the model's points, then of the picture's: inverse variances, shared among those that count, on
        the model by the length of outline that they stand for where the settings say so."""
        s = self.settings
        precision = (s.contour_std_fraction * gross_px).clamp_min(s.contour_std_px).square().reciprocal()[:, None]
        size = visible.length_px if s.by_length else torch.ones_like(visible.length_px)
        model = size * visible.outer
        if self.picture.valleys is not None:
            model = torch.add(model, size * visible.inner, alpha=s.valley_weight)
        is_hand = is_beyond_wrist(visible, boundary, _STEEP * length_px).to(precision)
        each = s.contour_weight * precision / model.sum(-1, keepdim=True).clamp_min(1)
        of_each = s.coverage_weight * precision / is_hand.sum(-1, keepdim=True).clamp_min(1)
        return torch.cat((each * model, of_each * is_hand), 1)


@dataclass(frozen=True, kw_only=True)
class ContourFactor:
    """½ Σ weight ρ(residual) of outer contour, valleys and coverage; a row per hand."""

    contours: Contours
    field: DistanceField
    valleys: DistanceField | None
    visible: VisibleContour
    pairs: Correspondences
    associated: PosedHands | None
    """The hands that data were associated with, whose motion may be known."""
    gross_px: Float[Tensor, "k"]
    near_px: Float[Tensor, "k"]
    view: int

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the DOFs, and in the shape where it is unknown."""
        moving = MovingContour.of(self.contours, self.visible, hands, self.associated)
        terms, cost = contour_terms(moving.motion.columns_px, self.field, self.valleys, self.pairs)
        return moving.equations(terms, cost)

    def rows(self, rows: Int[Tensor, "n"]) -> "ContourFactor":
        """The rows of some of the hands."""
        return replace(
            self,
            visible=self.visible.rows(rows),
            pairs=self.pairs.rows(rows),
            associated=None,
            gross_px=self.gross_px[rows],
            near_px=self.near_px[rows],
        )

    def explained(self) -> tuple[Explained, ...]:
        """What is explained of the picture's contour on the fingers' side of the wrist; infinitely far where no outline
        is visible."""
        pairs, points = self.pairs, self.visible.points_px
        weight = pairs.weight[:, points.shape[1] :]
        total = weight.sum(-1).clamp_min(1e-30)
        offset = boundary_offset(points.mT, pairs).abs()
        capped = torch.minimum(offset, self.gross_px[:, None])
        mean = torch.where(weight > 0, capped * weight, 0.0).sum(-1) / total
        near = torch.where(weight > 0, (offset <= self.near_px[:, None]) * weight, 0.0).sum(-1) / total
        is_seen = self.visible.outer.any(-1)
        return (
            Explained(
                name=CONTOUR,
                view=self.view,
                fraction=torch.where(is_seen, near, 0.0),
                distance=torch.where(is_seen, mean, torch.inf),
            ),
        )


def is_beyond_wrist(
    visible: VisibleContour, boundary: Boundary, min_px: Float[Tensor, "hands"]
) -> Bool[Tensor, "hands boundary"]:
    """Which points of the picture are on the fingers' side of the wrist: on the other there may be a forearm."""
    length = visible.distal_px.norm(dim=-1)
    x, y = boundary.points_px.to(length).T[:, None]
    (wrist_x, wrist_y), (axis_x, axis_y) = visible.wrist_px.T[..., None], visible.distal_px.T[..., None]
    ahead = (x - wrist_x) * axis_x + (y - wrist_y) * axis_y
    return (ahead > 0) | ~(length > min_px)[:, None]
