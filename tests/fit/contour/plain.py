"""The specification of the cost of contours: every kind of residual by itself, with a row of a Jacobian for each."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchhand.image import Boundary, DistanceField
from torchhand.numerics import NormalEquations
from torchhand.view import ContourMotion


@dataclass(frozen=True)
class Rows:
    """Residuals (hands, m), px, and their derivative in the DOFs (hands, m, 36)."""

    residual: Tensor
    jacobian: Tensor


def along(motion: ContourMotion, direction: Tensor) -> Tensor:
    """Derivative of direction · point in the DOFs; directions (hands, points, 2) are held."""
    return motion.slopes(direction.mT[:, None]).squeeze(1)


def outer_contour(motion: ContourMotion, field: DistanceField, channel: Tensor | None = None) -> Rows:
    """Signed distance of every model point from the picture's contour, by its distance map (Ouhaddi and Horain 1998,
    eq. 9 to 11). channel: of an oriented map, as `channel_of` the points' normals."""
    distance, gradient = field.sample(motion.columns_px.mT, channel)
    return Rows(distance, along(motion, gradient))


def valley(motion: ContourMotion, valleys: DistanceField) -> Rows:
    """Distance of every model point from the nearest dark line."""
    distance, gradient = valleys.sample(motion.columns_px.mT)
    return Rows(distance, along(motion, gradient))


def coverage(
    motion: ContourMotion, boundary: Boundary, match: Tensor, normals: Tensor, *, unmatched_px: float | Tensor
) -> Rows:
    """How far the model's outline lies beyond (positive) each point of the picture's boundary, along the normal that
    the model's point had when it was matched. Without a match (-1) it is `unmatched_px`, and nothing changes it."""
    index, has_match = match.clamp_min(0), match >= 0
    pairs = index[..., None].expand(-1, -1, 2)
    normal, place = normals.gather(1, pairs), motion.columns_px.mT.gather(1, pairs)
    offset = (normal * (place - boundary.points_px.to(place))).sum(-1)
    moved = along(motion, normals)
    moved = moved.gather(1, index[..., None].expand(-1, -1, moved.shape[-1]))
    far = torch.as_tensor(unmatched_px, dtype=offset.dtype).reshape(-1, 1)
    return Rows(torch.where(has_match, offset, far), torch.where(has_match[..., None], moved, 0.0))


def robust_equations(rows: Rows, weight: Tensor, gross_px: float | Tensor) -> NormalEquations:
    """Of ½ Σ weight r² / (1 + r² / gross²), the loss of Geman and McClure, by reweighted least squares; gross_px: one
    for all, or one for each hand."""
    scale = torch.as_tensor(gross_px, dtype=weight.dtype).reshape(-1, 1)
    squared = rows.residual.square()
    robust = 1 / (1 + squared / scale.square())
    weighted = (weight * robust.square())[..., None] * rows.jacobian
    return NormalEquations(
        matrix=weighted.mT @ rows.jacobian,
        gradient=(rows.residual[:, None] @ weighted).squeeze(1),
        cost=0.5 * (weight * squared * robust).sum(-1),
    )


def summed(*terms: NormalEquations) -> NormalEquations:
    """Of the sum of the costs."""
    return NormalEquations(
        matrix=torch.stack([term.matrix for term in terms]).sum(0),
        gradient=torch.stack([term.gradient for term in terms]).sum(0),
        cost=torch.stack([term.cost for term in terms]).sum(0),
    )
