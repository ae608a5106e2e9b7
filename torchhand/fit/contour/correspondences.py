"""What of the model's contour is compared with what of a picture, and the cost of it as terms at the model's points.

A model point lies either on the outer contour or on a valley; a point of the picture's boundary is compared with the
model point that it was matched to, along that one's normal. So two terms at each model point hold everything.
"""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.image import Boundary, DistanceField, channel_of
from torchhand.view import VisibleContour
from torchhand.view.contours import PointToLineTerms


@dataclass(frozen=True, kw_only=True)
class Correspondences:
    """What is compared with a picture, frozen about some hands; a row per hand."""

    normals: Float[Tensor, "hands 2 points"]
    """Normals of the model's points, as they were when the points were associated."""
    channel: Int[Tensor, "hands points"]
    """Channel of the outer contour's map, for every model point."""
    on_valley: Float[Tensor, "hands points"]
    """1 for points that are compared with the valleys, 0 for those that are compared with the outer contour."""
    match: Int[Tensor, "hands 2 boundary"]
    """The model point of every point of the picture's boundary, twice; any where there is none."""
    is_matched: Float[Tensor, "hands boundary"]
    """Whether the point has a match: 1, or 0 where it has none."""
    pair_normal: Float[Tensor, "hands 2 boundary"]
    """Normal of the match; 0 without one."""
    pair_offset: Float[Tensor, "hands boundary"]
    """Number that is taken from the product of that normal with the match's place, px."""
    weight: Float[Tensor, "hands terms"]
    """Weights of the model's points, then of the boundary's; px⁻²."""
    sharpness: Float[Tensor, "hands terms"]
    """Inverse squares of the distances beyond which residuals are gross; px⁻²."""

    @classmethod
    def of(
        cls,
        visible: VisibleContour,
        channels: int,
        boundary: Boundary,
        match: Int[Tensor, "hands boundary"],
        weight: Float[Tensor, "hands terms"],
        *,
        gross_px: Float[Tensor, "hands"],
        valley_gross_px: Float[Tensor, "hands"],
        unmatched_px: Float[Tensor, "hands"],
    ) -> "Correspondences":
        """match: -1 where there is none: the boundary's point is then `unmatched_px` off, and nothing changes it."""
        is_matched, on_valley, normals = (match >= 0).to(weight), visible.inner.to(weight), visible.normals.mT
        normals, pairs = normals.contiguous(), match.clamp_min(0)[:, None].expand(-1, 2, -1)
        normal = normals.gather(2, pairs) * is_matched[:, None]
        offset = (normal * boundary.points_px.T.to(normal)).sum(1)
        sharpness = gross_px[:, None].square().reciprocal().expand_as(weight).clone()
        of_valleys = valley_gross_px[:, None].square().reciprocal().expand_as(on_valley)
        sharpness[:, : on_valley.shape[1]].lerp_(of_valleys, on_valley)
        return cls(
            normals=normals,
            channel=channel_of(visible.normals, channels),
            on_valley=on_valley,
            match=pairs,
            is_matched=is_matched,
            pair_normal=normal,
            pair_offset=offset - unmatched_px[:, None] * (1 - is_matched),
            weight=weight,
            sharpness=sharpness,
        )

    def rows(self, rows: Int[Tensor, "k"]) -> "Correspondences":
        """The rows of some of the hands."""
        return Correspondences(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def boundary_offset(
    columns_px: Float[Tensor, "hands 2 points"], pairs: Correspondences
) -> Float[Tensor, "hands boundary"]:
    """How far the model's outline lies beyond (positive) each point of the picture's boundary, px."""
    return (pairs.pair_normal * columns_px.gather(2, pairs.match)).sum(1) - pairs.pair_offset


def contour_terms(
    columns_px: Float[Tensor, "hands 2 points"],
    field: DistanceField,
    valleys: DistanceField | None,
    pairs: Correspondences,
) -> tuple[PointToLineTerms, Float[Tensor, "hands"]]:
    """Terms at the model's points where they are now, and the cost ½ Σ weight r² / (1 + r² sharpness): the loss of
    Geman and McClure."""
    count = columns_px.shape[2]
    distance, slope = field.sample_columns(columns_px, pairs.channel)
    if valleys is not None:
        to_valley, valley_slope = valleys.sample_columns(columns_px)
        distance = torch.lerp(distance, to_valley, pairs.on_valley)
        slope = torch.lerp(slope, valley_slope, pairs.on_valley[:, None])
    residual = torch.cat((distance, boundary_offset(columns_px, pairs)), 1)
    squared = residual * residual
    robust = torch.addcmul(torch.ones_like(squared), squared, pairs.sharpness).reciprocal()
    weighted = pairs.weight * robust
    curvature = weighted * robust
    both = torch.stack((curvature, curvature * residual), 1)
    own, of_boundary = both.split((count, both.shape[2] - count), 2)
    covered = torch.zeros_like(own).scatter_add(2, pairs.match, of_boundary * pairs.is_matched[:, None])
    terms = torch.stack((own, covered), 2)
    return PointToLineTerms(
        direction=torch.stack((slope, pairs.normals), 1),
        curvature=terms[:, 0],
        gradient=terms[:, 1],
    ), 0.5 * (weighted * squared).sum(1)
