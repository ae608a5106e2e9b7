"""The residuals of contours as springs at the model's points, all kinds in one pass.

The same cost as `outer_contour_residual`, `valley_residual` and `coverage_residual` through `weighted_equations` with
the loss of Geman and McClure. A model point lies either on the outer contour or on a valley; a point of the picture's
boundary pulls at the model point that it was matched to, along that one's normal. So two springs at each model point
hold everything.
"""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.image import Boundary, DistanceField, channel_of
from torchhand.view import ContourLook
from torchhand.view.contours import Springs


@dataclass(frozen=True, kw_only=True)
class PictureTerms:
    """What is compared with a picture between two looks; a row per hand."""

    normals: Float[Tensor, "hands 2 points"]
    """Of the model's points when they were looked at."""
    channel: Int[Tensor, "hands points"]
    """Of the outer contour's map."""
    on_valley: Float[Tensor, "hands points"]
    """1 for points that are compared with the valleys, 0 for others: with the outer contour."""
    match: Int[Tensor, "hands 2 boundary"]
    """The model point of every point of the picture's boundary, twice; any where there is none."""
    is_matched: Float[Tensor, "hands boundary"]
    """1, or 0 where there is none."""
    pair_normal: Float[Tensor, "hands 2 boundary"]
    """That of the match; 0 without one."""
    pair_offset: Float[Tensor, "hands boundary"]
    """What is taken from the product of that normal with the match's place, px."""
    weight: Float[Tensor, "hands terms"]
    """Of the model's points, then of the boundary's; px⁻²."""
    sharpness: Float[Tensor, "hands terms"]
    """Inverse squares of the distances beyond which residuals are gross; px⁻²."""

    @classmethod
    def of(
        cls,
        look: ContourLook,
        channels: int,
        boundary: Boundary,
        match: Int[Tensor, "hands boundary"],
        weight: Float[Tensor, "hands terms"],
        *,
        robust_px: float,
        valley_robust_px: float,
        unmatched_px: float,
    ) -> "PictureTerms":
        """match: -1 where there is none: the boundary's point is then `unmatched_px` off, and nothing changes it."""
        is_matched, on_valley, normals = (match >= 0).to(weight), look.inner.to(weight), look.normals.mT.contiguous()
        pairs = match.clamp_min(0)[:, None].expand(-1, 2, -1)
        normal = normals.gather(2, pairs) * is_matched[:, None]
        offset = (normal * boundary.points_px.T.to(normal)).sum(1)
        apart = torch.full_like(weight, robust_px**-2)
        apart[:, : on_valley.shape[1]].lerp_(torch.full_like(on_valley, valley_robust_px**-2), on_valley)
        return cls(
            normals=normals,
            channel=channel_of(look.normals, channels),
            on_valley=on_valley,
            match=pairs,
            is_matched=is_matched,
            pair_normal=normal,
            pair_offset=offset - unmatched_px * (1 - is_matched),
            weight=weight,
            sharpness=apart,
        )

    def rows(self, rows: Int[Tensor, "k"]) -> "PictureTerms":
        """Those of the given hands."""
        return PictureTerms(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def boundary_offset(
    columns_px: Float[Tensor, "hands 2 points"], terms: PictureTerms
) -> Float[Tensor, "hands boundary"]:
    """How far the model's outline lies beyond (positive) each point of the picture's boundary, px; as
    `coverage_residual`."""
    return (terms.pair_normal * columns_px.gather(2, terms.match)).sum(1) - terms.pair_offset


def contour_springs(
    columns_px: Float[Tensor, "hands 2 points"],
    field: DistanceField,
    valleys: DistanceField | None,
    terms: PictureTerms,
) -> tuple[Springs, Float[Tensor, "hands"]]:
    """Springs at the model's points where they are now, and the cost: ½ Σ weight r² / (1 + r² sharpness)."""
    count = columns_px.shape[2]
    distance, slope = field.sample_columns(columns_px, terms.channel)
    if valleys is not None:
        to_valley, valley_slope = valleys.sample_columns(columns_px)
        distance = torch.lerp(distance, to_valley, terms.on_valley)
        slope = torch.lerp(slope, valley_slope, terms.on_valley[:, None])
    residual = torch.cat((distance, boundary_offset(columns_px, terms)), 1)
    squared = residual * residual
    fairness = torch.addcmul(torch.ones_like(squared), squared, terms.sharpness).reciprocal()
    weighted = terms.weight * fairness
    stiffness = weighted * fairness
    both = torch.stack((stiffness, stiffness * residual), 1)
    own, of_boundary = both.split((count, both.shape[2] - count), 2)
    covered = torch.zeros_like(own).scatter_add(2, terms.match, of_boundary * terms.is_matched[:, None])
    springs = torch.stack((own, covered), 2)
    return Springs(
        direction=torch.stack((slope, terms.normals), 1),
        stiffness=springs[:, 0],
        pull=springs[:, 1],
    ), 0.5 * (weighted * squared).sum(1)
