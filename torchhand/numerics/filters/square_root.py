"""The measurement update of a filter in square-root form, which leaves no indefinite covariance."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class PosteriorRoot:
    """What measurements with rows B and unit noise leave of a state y with zero mean and unit covariance.

    Q R = [B; I] is an orthogonal factorisation, so Rᵀ R = I + BᵀB is the information of y without that product being
    formed: a sum of squares would lose the prior beside a measurement that is better by half the digits of the type.
    B stands above I because the factorisation is accurate when large rows come first.
    """

    rows: Float[Tensor, "*batch m k"]  # B
    orthogonal: Float[Tensor, "*batch m_plus_k k"]  # Q
    upper: Float[Tensor, "*batch k k"]  # R; the signs of its diagonal mean nothing

    @classmethod
    def of(cls, rows: Float[Tensor, "*batch m k"]) -> "PosteriorRoot":
        """Factors B; differentiable."""
        unit = torch.eye(rows.shape[-1], dtype=rows.dtype, device=rows.device).expand(*rows.shape[:-2], -1, -1)
        orthogonal, upper = torch.linalg.qr(torch.cat((rows, unit), -2))
        return cls(rows=rows, orthogonal=orthogonal, upper=upper)

    def step(
        self, residual: Float[Tensor, "*batch m"], offset: Float[Tensor, "*batch k"] | None = None
    ) -> tuple[Float[Tensor, "*batch k"], Float[Tensor, "*batch"]]:
        """The d that minimises |residual - B d|² + |offset + d|², and its length |R d| in posterior deviations.

        None for `offset` is 0.
        """
        size = residual.shape[-1]
        half = self.orthogonal[..., :size, :].mT @ residual.unsqueeze(-1)
        if offset is not None:
            half = half - self.orthogonal[..., size:, :].mT @ offset.unsqueeze(-1)
        step = torch.linalg.solve_triangular(self.upper, half, upper=True)
        return step.squeeze(-1), half.square().sum((-2, -1)).sqrt()

    def covariance(self, root: Float[Tensor, "*batch n k"]) -> Float[Tensor, "*batch n n"]:
        """Covariance A (I + BᵀB)⁻¹ Aᵀ of A y after the measurement: a Gram matrix, positive semi-definite."""
        half = torch.linalg.solve_triangular(self.upper.mT, root.mT, upper=False)
        return half.mT @ half
