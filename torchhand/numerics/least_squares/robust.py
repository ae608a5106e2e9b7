"""Losses that let gross errors count for less, as weights of iteratively reweighted least squares."""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class RobustLoss:
    """½ scale² ρ(s) with s = |r|² / scale² for every group of residuals; least squares has ρ(s) = s."""

    kind: Literal["squares", "huber", "geman_mcclure"] = "huber"
    """huber: ρ = s up to 1, then 2√s - 1. geman_mcclure: ρ = s / (1 + s), which no single error exceeds."""
    scale: float = 1.0
    """Length of a residual beyond which it counts as gross, in the residuals' unit; above 0."""
    group: int = 1
    """Residuals in a row that share a weight (3 for points in space); 1 or more."""

    def __post_init__(self) -> None:
        if self.kind not in ("squares", "huber", "geman_mcclure"):
            raise ValueError(f"robust.kind: expected squares, huber or geman_mcclure, got {self.kind!r}")
        if not 0 < self.scale < float("inf"):
            raise ValueError(f"robust.scale: expected above 0 and finite, got {self.scale!r}")
        if self.group < 1:
            raise ValueError(f"robust.group: expected 1 or more, got {self.group!r}")

    def cost_and_weights(
        self, residual: Float[Tensor, "*batch m"]
    ) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch m"]]:
        """Sum of the losses, and dρ/ds for every residual: the gradient of the cost is Σ weight · r · dr."""
        if residual.shape[-1] % self.group:
            raise ValueError(f"residual: expected a multiple of {self.group} numbers, got {residual.shape[-1]}")
        squared = residual.unflatten(-1, (-1, self.group)).square().sum(-1) / self.scale**2
        loss, weight = self._rho(squared)
        return 0.5 * self.scale**2 * loss.sum(-1), weight.repeat_interleave(self.group, -1)

    def each(self, residual: Float[Tensor, "*batch m"]) -> tuple[Float[Tensor, "*batch m"], Float[Tensor, "*batch m"]]:
        """The loss and dρ/ds of every residual by itself, whatever the group."""
        squared = residual.square() / self.scale**2
        loss, weight = self._rho(squared)
        return 0.5 * self.scale**2 * loss, weight

    def _rho(self, squared: Float[Tensor, "*batch m"]) -> tuple[Tensor, Tensor]:
        """ρ and its derivative."""
        if self.kind == "huber":
            beyond = squared.clamp_min(1.0)
            return torch.where(squared <= 1, squared, 2 * beyond.sqrt() - 1), beyond.rsqrt()
        if self.kind == "geman_mcclure":
            return squared / (1 + squared), (1 + squared).square().reciprocal()
        return squared, torch.ones_like(squared)
