"""What a fit into a hull sees of its model in some poses, and where its hypotheses ended."""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit.hull.cost import HullCost
from torchhand.fit.hull.skin import PosedBones


@dataclass(frozen=True, kw_only=True)
class SeenHull:
    """The vertices that belong to the points of a hull's surface; a row per hypothesis."""

    match: Int[Tensor, "k hull"]
    points: Float[Tensor, "hull 3"]
    """Of the hull's surface, or of the rays."""
    normals: Float[Tensor, "k hull 3"]
    """Of those vertices, or of the rays."""
    apart: Float[Tensor, "k hull"]
    """Their distance across the surface, metres; infinite where they are beside it."""
    is_hand: Float[Tensor, "k hull"]
    """1 for points on the fingers' side of the wrist or as far beyond it as the settings say, 0 for others: there may
    be a forearm, which the model has not."""


@dataclass(frozen=True, kw_only=True)
class HullLook:
    """The model in some poses, and the cost about them; a row per hypothesis."""

    cost: HullCost
    bones: PosedBones
    seen: SeenHull
    beyond: Float[Tensor, "k points"] | None
    """Distance of the vertices that must be inside from the hull's surface, metres, negative inside; None where nobody
    asked."""


@dataclass(frozen=True, kw_only=True)
class EndedFits:
    """Where the last optimiser of some hypotheses ended, and what that cost by its look; a row per hypothesis."""

    pose: Float[Tensor, "k 36"]
    reference: Float[Tensor, "k 3 3"]
    cost: Float[Tensor, "k"]
    status: Int[Tensor, "k"]
    matrix: Float[Tensor, "k free free"]
    inside: Float[Tensor, "k"]
    """Share of the skin inside the hull."""
    held: Float[Tensor, "k"]
    """Share of it that is near the hull or inside."""
    apart: Float[Tensor, "k"]
    """Mean distance of edges or surface from the skin, cut off, metres."""
    covered: Float[Tensor, "k"]
    """Share of them that is near the skin."""

    def or_better(self, other: "EndedFits") -> "EndedFits":
        """The cheaper of the two, hypothesis by hypothesis."""
        better = other.cost <= self.cost

        def chosen(one: Tensor, two: Tensor) -> Tensor:
            return torch.where(better.reshape(-1, *(1,) * (one.ndim - 1)), two, one)

        return EndedFits(**{f.name: chosen(getattr(self, f.name), getattr(other, f.name)) for f in fields(EndedFits)})
