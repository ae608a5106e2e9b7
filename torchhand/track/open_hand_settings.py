"""Settings of the fit of pose and shape to one open hand."""

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True, kw_only=True)
class OpenHandSettings:
    """How the digits that were measured and the outline are weighed against what people's hands are like."""

    tip_std: float = 0.008
    """Standard deviation of a measured fingertip, share of the hand's length; above 0."""
    axis_std: float = 0.008
    """Of a joint's distance from the measured axis of its digit, as such a share; above 0."""
    web_std: float = 0.015
    """Of a digit's base, level with the webs, as such a share; above 0."""
    wrist_std: float = 0.06
    """Of the wrist, as such a share; above 0."""
    digit_share: float = 0.15
    """Factor on the residuals of the measured digits while the outline is fitted, which tells more; 0 or more."""
    corrected_share: float = 1.0
    """The same factor once the digits are corrected by those of the model's own silhouette; 0 or more."""
    more_iterations: int = 8
    """Steps of that second fit; 2 or more."""
    iterations: int = 14
    """Steps of the fit to the outline; 2 or more."""
    search_share: float = 0.04
    """First half length of the edge search, as a share of the hand's length in the picture; above 0."""
    final_search_share: float = 0.025
    """Last half length, as such a share; above 0."""
    least_edge_std_px: float = 0.1
    """Least standard deviation that is believed of an edge, whatever the residuals say; above 0."""
    most_edge_std: float = 0.005
    """Greatest, as a share of the hand's length; above 0."""
    points_per_generator: int = 10
    """Outline points compared on each straight side of a primitive; 2 or more."""
    points_per_arc: int = 8
    """And on each round end; 2 or more."""

    def __post_init__(self) -> None:
        for name in (
            "tip_std",
            "axis_std",
            "web_std",
            "wrist_std",
            "search_share",
            "final_search_share",
            "most_edge_std",
        ):
            if not 0 < getattr(self, name) < inf:
                raise ValueError(f"{name}: expected above 0 and finite, got {getattr(self, name)!r}")
        for name in ("least_edge_std_px",):
            if not 0 < getattr(self, name) < inf:
                raise ValueError(f"{name}: expected above 0 and finite, got {getattr(self, name)!r}")
        for name in ("digit_share", "corrected_share"):
            if not 0 <= getattr(self, name) < inf:
                raise ValueError(f"{name}: expected 0 or more and finite, got {getattr(self, name)!r}")
        for name in ("iterations", "more_iterations", "points_per_generator", "points_per_arc"):
            if not getattr(self, name) >= 2:
                raise ValueError(f"{name}: expected 2 or more, got {getattr(self, name)!r}")
