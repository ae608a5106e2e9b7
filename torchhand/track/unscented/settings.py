"""Settings of the unscented update on edges along contour normals."""

from dataclasses import dataclass, field
from typing import Literal

from torchhand.errors import require, require_positive
from torchhand.image import EdgeSettings
from torchhand.numerics import UnscentedSettings
from torchhand.track.belief import PosturePriorSettings


@dataclass(frozen=True, kw_only=True)
class UnscentedUpdateSettings:
    """Edges along the normals of the predicted contour, through sigma points (Stenger et al. 2001, section 4)."""

    edges_in: Literal["colour", "grey"] = "colour"
    """Picture in which the outer contour is searched: probability of the hand's colours, or grey levels (Stenger et al.
    2001)."""
    transform: UnscentedSettings = field(default_factory=UnscentedSettings)
    outer_edges: EdgeSettings = field(
        default_factory=lambda: EdgeSettings(polarity="inside_bright", min_strength=0.2, choose="nearest")
    )
    """Search on the silhouette."""
    inner_edges: EdgeSettings = field(default_factory=lambda: EdgeSettings(min_strength=0.04, choose="nearest"))
    """Search where a part of the hand lies before another, in grey levels."""
    inner_weight: float = 0.15
    """Weight of an inner edge relative to an outer one; 0 or more, 0 leaves them out."""
    edge_std_px: float = 2.5
    """Standard deviation of one edge, neighbours being correlated; above 0."""
    gate: float = 9.0
    """Edges whose squared innovation exceeds this many times its variance are refused; above 0."""
    search_fraction: float = 0.06
    """Half length of the edge search as a share of the hand's length in the picture; above 0."""
    passes: int = 1
    """Measurement updates per frame with fresh edges, each with its share of the weight; 1 or more."""
    prior: PosturePriorSettings = field(default_factory=PosturePriorSettings)

    def __post_init__(self) -> None:
        require(self.edges_in in ("colour", "grey"), "update.edges_in", "colour or grey", self.edges_in)
        for name in ("edge_std_px", "gate", "search_fraction"):
            require_positive(f"update.{name}", getattr(self, name))
        require(self.passes >= 1, "update.passes", "1 or more", self.passes)
        is_weight = 0 <= self.inner_weight < float("inf")
        require(is_weight, "update.inner_weight", "0 or more and finite", self.inner_weight)
