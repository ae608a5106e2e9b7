"""Settings of the fit of pose and shape to one open hand."""

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True, kw_only=True)
class OpenHandSettings:
    """How measured digits, outline and shading are weighed against what people's hands are like."""

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
    iterations: int = 9
    """Steps of the fit to the outline; 2 or more."""
    search_share: float = 0.04
    """First half length of the edge search, as a share of the hand's length in the picture; above 0."""
    final_search_share: float = 0.025
    """Last half length, as such a share; above 0."""
    least_edge_std_px: float = 0.1
    """Least standard deviation that is believed of an edge, whatever the residuals say; above 0."""
    most_edge_std: float = 0.005
    """Greatest, as a share of the hand's length; above 0."""
    squares_along: int = 140
    """Squares of pixels along the hand, as which shading is compared, near creases twice as many; 20 or more."""
    shading_iterations: int = 5
    """Most steps of each of the five fits to the shading; 1 or more."""
    most_shading_misfit: float = 0.5
    """Residuals of the shading before it is fitted, over its contrast, beyond which it is left alone; above 0."""
    most_shading_rest: float = 0.2
    """The same once it is fitted coarsely; above 0."""
    most_shading_excess: float = 4.0
    """Residuals after that, over what neighbours differ by, beyond which it is not believed; above 1."""
    shading_std_factor: float = 1.8
    """What the noise of the shading is multiplied by for the deviations of the result: parts meet less sharply than
    the formulas say; 1 or more."""
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
            "least_edge_std_px",
            "most_shading_misfit",
            "most_shading_rest",
        ):
            if not 0 < getattr(self, name) < inf:
                raise ValueError(f"{name}: expected above 0 and finite, got {getattr(self, name)!r}")
        for name in ("digit_share", "corrected_share"):
            if not 0 <= getattr(self, name) < inf:
                raise ValueError(f"{name}: expected 0 or more and finite, got {getattr(self, name)!r}")
        for name in ("iterations", "more_iterations", "points_per_generator", "points_per_arc"):
            if not getattr(self, name) >= 2:
                raise ValueError(f"{name}: expected 2 or more, got {getattr(self, name)!r}")
        if not self.squares_along >= 20:
            raise ValueError(f"squares_along: expected 20 or more, got {self.squares_along!r}")
        if not self.shading_iterations >= 1:
            raise ValueError(f"shading_iterations: expected 1 or more, got {self.shading_iterations!r}")
        if not 1 < self.most_shading_excess < inf:
            raise ValueError(f"most_shading_excess: expected above 1 and finite, got {self.most_shading_excess!r}")
        if not 1 <= self.shading_std_factor < inf:
            raise ValueError(f"shading_std_factor: expected 1 or more and finite, got {self.shading_std_factor!r}")
