"""How a hand is registered on distance maps: levels from coarse to fine, and how much each kind of residual counts."""

from dataclasses import dataclass, field
from typing import Literal

from torchhand.image import ValleySettings


@dataclass(frozen=True, kw_only=True)
class RegistrationLevel:
    """One step from coarse to fine."""

    pitch_px: int = 1
    """Pixels of the picture per pixel of the distance map; less where the hand is small. 1 or more."""
    robust_share: float = 0.03
    """Distance beyond which a residual counts as gross, share of the hand's length in the picture; above 0."""
    rounds: int = 2
    """Looks at the model: which points are visible, and which of them belong to which of the picture's; 1 or more."""
    iterations: int = 4
    """Most steps of the optimiser after each look; 1 or more."""

    def __post_init__(self) -> None:
        for name in ("pitch_px", "rounds", "iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"level.{name}: expected 1 or more, got {getattr(self, name)!r}")
        if not 0 < self.robust_share < float("inf"):
            raise ValueError(f"level.robust_share: expected above 0 and finite, got {self.robust_share!r}")


LEVELS = (
    RegistrationLevel(pitch_px=4, robust_share=0.10, rounds=2, iterations=4),
    RegistrationLevel(pitch_px=2, robust_share=0.05, rounds=2, iterations=3),
    RegistrationLevel(pitch_px=1, robust_share=0.02, rounds=2, iterations=3),
)
"""For starts that may be 15° and 10 mm off."""
TRACKING_LEVELS = (
    RegistrationLevel(pitch_px=2, robust_share=0.05, rounds=1, iterations=3),
    RegistrationLevel(pitch_px=1, robust_share=0.02, rounds=1, iterations=4),
)
"""For starts near the pose, such as a prediction: a third of the time."""


@dataclass(frozen=True, kw_only=True)
class RegistrationSettings:
    """Coarse to fine, weights and optimiser."""

    levels: tuple[RegistrationLevel, ...] = LEVELS
    """At least one; the last one decides about cost, status and covariance."""
    method: Literal["levenberg_marquardt", "descent"] = "levenberg_marquardt"
    """descent: plain gradient descent, ten times the iterations."""
    directions: int = 8
    """Directions of the contour that the maps keep apart; 1 (paper 000) to 64."""
    boundary_points: int = 256
    """Most points of the picture's contour that the model must explain; 8 or more."""
    contour_std_px: float = 2.0
    """Standard deviation of the contour's distance from the model, px, at least; above 0."""
    contour_std_share: float = 0.5
    """The same as a share of a level's robust distance: coarse levels may be wrong about what belongs to what, and
    should leave more to what is believed of the pose. Above 0."""
    contour_weight: float = 60.0
    """Independent measurements that all outer model points together are worth; 0 or more."""
    coverage_weight: float = 60.0
    """The same of the picture's contour points; 0 or more. Without it a folded hand inside the silhouette costs
    nothing."""
    valley_weight: float = 0.5
    """Worth of an inner model point near a valley, over that of an outer one; 0 or more, 0 leaves valleys out."""
    valley_robust_share: float = 0.015
    """Distance beyond which a valley is not a point's, share of the hand's length in the picture; above 0."""
    constraint_weight: float = 1.0
    """Of the dynamic constraints; 0 or more. The static limits hold exactly."""
    prior_weight: float = 1.0
    """Of the posture prior, where one is given; 0 or more."""
    turn_share: float = 0.12
    """Distance that a turn of the contour by one radian is worth in matching, share of the hand's length; above 0."""
    beyond_share: float = 0.012
    """How far outside a model point the hand must end for an outer one, share of the hand's length; above 0."""
    hypotheses_at_once: int = 128
    """Hypotheses that are worked on together; bounds the memory. 1 or more."""
    valleys: ValleySettings = field(default_factory=ValleySettings)

    def __post_init__(self) -> None:
        if not self.levels:
            raise ValueError("registration.levels: expected at least one")
        if self.method not in ("levenberg_marquardt", "descent"):
            raise ValueError(f"registration.method: expected levenberg_marquardt or descent, got {self.method!r}")
        if not 1 <= self.directions <= 64:
            raise ValueError(f"registration.directions: expected 1 to 64, got {self.directions!r}")
        for name, least in (("boundary_points", 8), ("hypotheses_at_once", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"registration.{name}: expected {least} or more, got {getattr(self, name)!r}")
        for name in ("contour_std_px", "contour_std_share", "valley_robust_share", "turn_share", "beyond_share"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"registration.{name}: expected above 0 and finite, got {getattr(self, name)!r}")
        for name in ("contour_weight", "coverage_weight", "valley_weight", "constraint_weight", "prior_weight"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"registration.{name}: expected 0 or more and finite, got {getattr(self, name)!r}")
