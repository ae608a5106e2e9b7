"""What a fresh look makes of registered values: their cost, how far they are from the picture, how certain they are."""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.contour.cost import RegistrationCost
from torchhand.fit.contour.springs import boundary_offset
from torchhand.numerics import NormalEquations


@dataclass(frozen=True, kw_only=True)
class Judged:
    """Values that have been looked at anew, and what they cost; a row per hypothesis."""

    values: Float[Tensor, "k free"]
    reference: Float[Tensor, "k 3 3"]
    cost: Float[Tensor, "k"]
    contour_px: Float[Tensor, "k"]
    equations: NormalEquations
    """As computed, of failed ones too."""

    @classmethod
    def of(cls, cost: RegistrationCost, values: Float[Tensor, "k free"], robust_px: float) -> "Judged":
        """Of the values that the cost was made around. robust_px: at which the contour's distance is cut off."""
        look, terms, found = cost.held.look, cost.held.terms, cost.at_look(values)
        offset = boundary_offset(look.points_px.mT, terms).abs().clamp_max(robust_px)
        share = terms.weight[:, look.points_px.shape[1] :]
        mean = torch.where(share > 0, offset * share, 0.0).sum(-1) / share.sum(-1).clamp_min(1e-30)
        is_seen = look.outer.any(-1) & found.cost.isfinite() & found.gradient.isfinite().all(-1)
        return cls(
            values=values,
            reference=cost.held.root_reference,
            cost=torch.where(is_seen, found.cost, torch.inf),
            contour_px=torch.where(is_seen, mean, torch.inf),
            equations=found,
        )

    def or_better(self, other: "Judged") -> "Judged":
        """The cheaper of the two, hypothesis by hypothesis."""
        better = other.cost <= self.cost
        if bool(better.all()):
            return other

        def chosen(one: Tensor, two: Tensor) -> Tensor:
            return torch.where(better.reshape(-1, *(1,) * (one.ndim - 1)), two, one)

        pairs = {
            f.name: (getattr(self.equations, f.name), getattr(other.equations, f.name)) for f in fields(NormalEquations)
        }
        return Judged(
            values=chosen(self.values, other.values),
            reference=chosen(self.reference, other.reference),
            cost=chosen(self.cost, other.cost),
            contour_px=chosen(self.contour_px, other.contour_px),
            equations=NormalEquations(**{name: chosen(*pair) for name, pair in pairs.items()}),
        )


def covariance_of(
    matrix: Float[Tensor, "hypotheses free free"], is_good: Bool[Tensor, "hypotheses"]
) -> Float[Tensor, "hypotheses free free"]:
    """Inverses of the matrices of the normal equations; NaN where they are not positive definite or not good."""
    identity = torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
    factor, info = torch.linalg.cholesky_ex(torch.where(is_good[:, None, None], matrix, identity))
    is_known = ((info == 0) & is_good)[:, None, None]
    return torch.where(is_known, torch.cholesky_inverse(torch.where(is_known, factor, identity)), torch.nan)
