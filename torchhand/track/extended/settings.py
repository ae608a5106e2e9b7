"""Settings of the extended update on registered limb segments."""

from dataclasses import dataclass, field
from typing import Literal

from torchhand.errors import require, require_positive
from torchhand.fit.contour import ContourSettings
from torchhand.track.extended.segment_observation import SegmentSettings


@dataclass(frozen=True, kw_only=True)
class ExtendedUpdateSettings:
    """Registration on distance maps, steadied by an extended Kalman filter over the registered limb segments (Ouhaddi
    and Horain 1998, section 7)."""

    surface: Literal["primitives", "mesh"] = "primitives"
    """Surface whose contours are registered: the quadrics', or the skin's, which takes several times as long."""
    contour: ContourSettings = field(default_factory=lambda: ContourSettings(contour_std_fraction=0.25))
    """Weights of contours, coverage and valleys."""
    constraint_weight: float = 1.0
    """Weight of the constraints between joints; 0 or more, 0 leaves them out."""
    prior_weight: float = 1.0
    """Weight of the posture prior; 0 or more, 0 leaves it out."""
    hypotheses: bool = True
    """Whether a bad registration is repeated from other places, directions, postures and fingers, and a good one from
    other fingers."""
    finger_proposals: int = 2
    """Proposals with one finger straight or bent beside a good registration; the fingers take turns. 0 to 10."""
    filter: Literal["extended", "none"] = "extended"
    """The extended Kalman filter over the segments of the registered hand, or the registered hand as it is."""
    segments: SegmentSettings = field(default_factory=SegmentSettings)
    """Settings of the segments that the filter observes of the registered hand."""
    pose_weight: float = 0.25
    """Weight of the registered parameters themselves, with the registration's covariance, beside the segments, which
    leave open what the palm and hidden fingers do; 0 or more, 0 leaves them out."""
    gate: float = 40.0
    """Segments whose squared innovation exceeds this many times its variance are refused; above 0."""

    def __post_init__(self) -> None:
        require(self.surface in ("primitives", "mesh"), "update.surface", "primitives or mesh", self.surface)
        require(self.filter in ("extended", "none"), "update.filter", "extended or none", self.filter)
        is_count = 0 <= self.finger_proposals <= 10
        require(is_count, "update.finger_proposals", "0 to 10", self.finger_proposals)
        require_positive("update.gate", self.gate)
        for name in ("pose_weight", "constraint_weight", "prior_weight"):
            value = getattr(self, name)
            require(0 <= value < float("inf"), f"update.{name}", "0 or more and finite", value)
