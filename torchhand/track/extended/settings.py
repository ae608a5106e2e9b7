"""Settings of the extended update on registered limb segments."""

from dataclasses import dataclass, field, replace
from typing import Literal

from torchhand.errors import require, require_positive
from torchhand.fit import Schedule, Stage
from torchhand.fit.contour import SEARCH, ContourSettings
from torchhand.hand import POSTURES
from torchhand.numerics import AdaptiveNoiseSettings, IteratedSettings
from torchhand.track.extended.segment_observation import SegmentSettings

_FINEST_M = 0.0075
"""Gross distance of the finest stage: with less, a finger that is not covered at all costs next to nothing."""
_SCHEDULE = (
    Stage(gross_m=1.5 * _FINEST_M, rounds=1, iterations=3, pitch_px=2),
    Stage(gross_m=_FINEST_M, rounds=1, iterations=4, pitch_px=1),
)
_SEARCH = (*SEARCH[:-1], replace(SEARCH[-1], gross_m=_FINEST_M))


@dataclass(frozen=True, kw_only=True)
class ExtendedUpdateSettings:
    """Registration on distance maps, steadied by an extended Kalman filter over the registered limb segments (Ouhaddi
    and Horain 1998, section 7)."""

    surface: Literal["primitives", "mesh"] = "primitives"
    """Surface whose contours are registered: the quadrics', or the skin's, which takes several times as long."""
    contour: ContourSettings = field(default_factory=lambda: ContourSettings(contour_std_fraction=0.25))
    """Weights of contours, coverage and valleys."""
    schedule: Schedule = _SCHEDULE
    """Registration of a scene from its prediction."""
    search_schedule: Schedule = _SEARCH
    """Registration of the scene in which a hand is found, and of a hand that is sought anew."""
    constraint_weight: float = 1.0
    """Weight of the constraints between joints; 0 or more, 0 leaves them out."""
    prior_weight: float = 1.0
    """Weight of the posture prior; 0 or more, 0 leaves it out."""
    adaptive: AdaptiveNoiseSettings = field(default_factory=AdaptiveNoiseSettings)
    """How the process noise is learned."""
    is_adaptive: bool = True
    """Whether it is learned at all."""
    hypotheses: bool = True
    """Whether a bad registration is repeated from other places, directions, postures and fingers, and a good one from
    other fingers."""
    finger_proposals: int = 2
    """Proposals with one finger straight or bent beside a good registration; the fingers take turns. 0 to 10."""
    max_cost_ratio: float = 1.5
    """Largest cost of such a proposal, over that of the registration, with which it is followed up; 1 or more."""
    postures: tuple[str, ...] = ("flat", "fist", "point")
    """Postures tried beside that of the start, and single fingers straight or bent, where registration is bad: names
    of torchhand.hand.POSTURES."""
    max_contour_distance_m: float = 0.0015
    """Largest mean distance of the picture's contour from the model's with which a registration is good, metres at the
    hand; above 0."""
    relocation_ratio: float = 2.0
    """Mean distance of the contours, over the largest good one, beyond which the hand is sought elsewhere in the
    picture and in other directions; 1 or more."""
    near_m: float = 0.00374
    """Distance from the picture's contour within which a point of the model's lies on it, metres at the hand; above
    0."""
    filter: Literal["extended", "none"] = "extended"
    """The extended Kalman filter over the segments of the registered hand, or the registered hand as it is."""
    segments: SegmentSettings = field(default_factory=SegmentSettings)
    """Settings of the segments that the filter observes of the registered hand."""
    pose_weight: float = 0.25
    """Weight of the registered parameters themselves, with the registration's covariance, beside the segments, which
    leave open what the palm and hidden fingers do; 0 or more, 0 leaves them out."""
    iterated: IteratedSettings = field(default_factory=lambda: IteratedSettings(iterations=4))
    gate: float = 40.0
    """Segments whose squared innovation exceeds this many times its variance are refused; above 0."""
    restart_fraction: float = 0.5
    """Fraction of the visible segments that must pass the gate, or else the filter starts afresh at the registered
    hand; 0 to 1."""

    def __post_init__(self) -> None:
        require(self.surface in ("primitives", "mesh"), "update.surface", "primitives or mesh", self.surface)
        require(self.filter in ("extended", "none"), "update.filter", "extended or none", self.filter)
        is_count = 0 <= self.finger_proposals <= 10
        require(is_count, "update.finger_proposals", "0 to 10", self.finger_proposals)
        for name in ("max_cost_ratio", "relocation_ratio"):
            require(1 <= getattr(self, name) < float("inf"), f"update.{name}", "1 or more", getattr(self, name))
        for name in ("max_contour_distance_m", "near_m", "gate"):
            require_positive(f"update.{name}", getattr(self, name))
        for name in ("pose_weight", "constraint_weight", "prior_weight"):
            value = getattr(self, name)
            require(0 <= value < float("inf"), f"update.{name}", "0 or more and finite", value)
        require(0 <= self.restart_fraction <= 1, "update.restart_fraction", "0 to 1", self.restart_fraction)
        for name in self.postures:
            require(name in POSTURES, "update.postures", f"names among {', '.join(POSTURES)}", name)
