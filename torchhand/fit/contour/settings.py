"""How much the contours of a picture count, and how they are compared with the model's."""

from dataclasses import dataclass, replace

from torchhand.errors import require, require_positive
from torchhand.fit import Stage

SEARCH = (
    Stage(gross_m=0.0187, rounds=2, iterations=4, pitch_px=4),
    Stage(gross_m=0.00935, rounds=2, iterations=3, pitch_px=2),
    Stage(gross_m=0.00374, rounds=2, iterations=3, pitch_px=1),
)
"""For starts that may be 15° and 10 mm off."""
WHOLE_SEARCH = (*SEARCH[:-1], replace(SEARCH[-1], gross_m=0.0075))
"""As SEARCH with a wider last stage: in that of SEARCH a finger that is not covered at all costs next to nothing."""
QUICK_SEARCH = (
    Stage(gross_m=0.0187, rounds=1, iterations=5, pitch_px=4, thinning=2),
    Stage(gross_m=0.00374, rounds=2, iterations=3, pitch_px=1),
)
"""As SEARCH in half the time: a stage less, and every second point until the last look. The tilted hands of a recording
end as near to the truth, in the mean over six simulated ones."""
THIN_SEARCH = (
    Stage(gross_m=0.0187, rounds=1, iterations=5, pitch_px=4, thinning=4),
    Stage(gross_m=0.00935, rounds=1, iterations=5, pitch_px=2, thinning=2),
    Stage(gross_m=0.00374, rounds=1, iterations=5, pitch_px=1, thinning=2),
    Stage(gross_m=0.00187, rounds=1, iterations=5, pitch_px=1),
)
"""As SEARCH, with every fourth or second point until the last look at the picture and without second ones: for many
starts, in less than half the time. The last stage is half as wide, for silhouettes that are good to a pixel: between
hands that are nearly right, only residuals of a few pixels tell."""
WIDE_SEARCH = (
    Stage(gross_m=0.075, rounds=1, iterations=3, pitch_px=8, thinning=3),
    Stage(gross_m=0.0374, rounds=1, iterations=4, pitch_px=8, thinning=3),
    Stage(gross_m=0.0187, rounds=1, iterations=4, pitch_px=4, thinning=2),
    Stage(gross_m=0.00935, rounds=1, iterations=3, pitch_px=2, thinning=2),
)
"""For starts from whose fingers another finger of the picture may be nearer than their own: looks as far as several
fingers are broad, and loses what was near already. To be followed by a finer stage."""
TRACKING = (
    Stage(gross_m=0.00935, rounds=1, iterations=3, pitch_px=2),
    Stage(gross_m=0.00374, rounds=1, iterations=4, pitch_px=1),
)
"""For starts near the pose, such as a prediction: a third of the time."""


@dataclass(frozen=True, kw_only=True)
class ContourSettings:
    """Weights and tolerances of contours on distance maps."""

    directions: int = 8
    """Directions of the contour that the maps keep apart, 1 to 64; 1 in Ouhaddi and Horain (1998)."""
    boundary_points: int = 256
    """Most points of the picture's contour that the model must explain; 8 or more."""
    contour_std_px: float = 2.0
    """Smallest standard deviation of the contour's distance from the model, px; above 0."""
    contour_std_fraction: float = 0.5
    """Standard deviation of the contour's distance over the distance at which a stage takes residuals for gross: coarse
    stages may be wrong about what belongs to what, and leave more to the priors. Above 0."""
    contour_weight: float = 60.0
    """Independent measurements that the model's outline is worth, outer and inner, shared out among its points; 0 or
    more."""
    by_length: bool = False
    """Whether a point of the model counts by the length of outline that it stands for, or as much as any other. Points
    are crowded on fingertips and knuckles. By length the hand that explains the outline best is more often the right
    one of several (studies); one that is followed keeps its bent fingers better where every point counts the same."""
    coverage_weight: float = 60.0
    """Independent measurements that the picture's contour points are worth; 0 or more. Without them a hand folded
    inside the silhouette costs nothing."""
    valley_weight: float = 0.5
    """Worth of an inner point (or length) near a valley over that of an outer one; 0 or more, 0 leaves valleys out."""
    probe_distance_m: float = 0.00224
    """Distance outside a model point at which the hand must have ended for the point to be an outer one, metres at the
    hand; above 0."""

    def __post_init__(self) -> None:
        require(1 <= self.directions <= 64, "contour.directions", "1 to 64", self.directions)
        require(self.boundary_points >= 8, "contour.boundary_points", "8 or more", self.boundary_points)
        for name in ("contour_std_px", "contour_std_fraction", "probe_distance_m"):
            require_positive(f"contour.{name}", getattr(self, name))
        for name in ("contour_weight", "coverage_weight", "valley_weight"):
            value = getattr(self, name)
            require(0 <= value < float("inf"), f"contour.{name}", "0 or more and finite", value)
