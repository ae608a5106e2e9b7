"""Settings of the distance-map tracker; configs/distance_*.yaml hold differences from these."""

from dataclasses import dataclass, field, replace
from typing import Literal

from torchhand.fit.contour import LEVELS, RegistrationLevel, RegistrationSettings
from torchhand.hand import POSTURES
from torchhand.numerics import AdaptiveNoiseSettings, IteratedSettings, MotionModel
from torchhand.track import NoiseSettings, TrackerSettings, require, require_positive
from torchhand.track.extended.segment_observation import SegmentSettings

_FINEST = 0.04
"""Robust distance of the finest level: with less, a finger that is not covered at all costs next to nothing."""
_STD_SHARE = 0.25
_FOLLOWING = RegistrationSettings(
    levels=(
        RegistrationLevel(pitch_px=2, robust_share=1.5 * _FINEST, rounds=1, iterations=3),
        RegistrationLevel(pitch_px=1, robust_share=_FINEST, rounds=1, iterations=4),
    ),
    contour_std_share=_STD_SHARE,
)
_STARTING = RegistrationSettings(
    levels=(*LEVELS[:-1], replace(LEVELS[-1], robust_share=_FINEST)), contour_std_share=_STD_SHARE
)


@dataclass(frozen=True, kw_only=True)
class DistanceTrackerSettings(TrackerSettings):
    """Paper 000's tracker."""

    method: Literal["distance"] = "distance"
    """The distance-map tracker."""
    motion: MotionModel = field(default_factory=lambda: MotionModel(order=1, velocity_decay_s=0.15))
    """Order 1 is the paper's state: parameters and velocities."""
    noise: NoiseSettings = field(default_factory=lambda: NoiseSettings(translation=4.0, rotation=20.0, angle=30.0))
    adaptive: AdaptiveNoiseSettings = field(default_factory=AdaptiveNoiseSettings)
    """How the process noise is learned."""
    is_adaptive: bool = True
    """Whether it is learned at all."""
    surface: Literal["primitives", "mesh"] = "primitives"
    """Whose contours are registered: the quadrics', or the skin's, which takes several times as long."""
    registration: RegistrationSettings = _FOLLOWING
    """Of every picture."""
    search: RegistrationSettings = _STARTING
    """Of the picture of a start."""
    hypotheses: bool = True
    """Whether a bad registration is repeated from other places, directions, postures and fingers, and a good one from
    other fingers."""
    reconsidered: int = 2
    """Fingers, straight or bent, that are tried beside a good registration; they take turns. 0 to 10."""
    promising: float = 1.5
    """A finger so tried is followed up where its cost is at most so many times that of the registration; 1 or more."""
    postures: tuple[str, ...] = ("flat", "fist", "point")
    """Postures tried beside that of the start, and single fingers straight or bent, where registration is bad: names
    of torchhand.hand.POSTURES."""
    bad_share: float = 0.008
    """Mean distance of the picture's contour from the model's above which registration is bad, share of the hand's
    length in the picture; above 0."""
    sudden: float = 2.0
    """Times that distance, beyond which the hand is sought elsewhere in the picture and in other directions; 1 or
    more."""
    near_share: float = 0.02
    """Distance from the picture's contour within which a point of the model's lies on it, the same share; above 0."""
    filter: Literal["extended", "none"] = "extended"
    """The extended Kalman filter over the segments of the registered hand, or the registered hand as it is."""
    segments: SegmentSettings = field(default_factory=SegmentSettings)
    """What the filter observes of the registered hand."""
    pose_weight: float = 0.25
    """Weight of the registered parameters themselves, with the registration's covariance, beside the segments, which
    leave open what the palm and hidden fingers do; 0 or more, 0 leaves them out."""
    iterated: IteratedSettings = field(default_factory=lambda: IteratedSettings(iterations=4))
    gate: float = 40.0
    """Segments whose squared innovation exceeds this many times its variance are refused; above 0."""
    sudden_share: float = 0.5
    """The filter starts afresh at the registered hand where fewer of the visible segments than this pass the gate; 0
    to 1."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.method == "distance", "method", "distance", self.method)
        require(self.surface in ("primitives", "mesh"), "surface", "primitives or mesh", self.surface)
        require(self.filter in ("extended", "none"), "filter", "extended or none", self.filter)
        require(0 <= self.reconsidered <= 10, "reconsidered", "0 to 10", self.reconsidered)
        require(1 <= self.promising < float("inf"), "promising", "1 or more and finite", self.promising)
        require(1 <= self.sudden < float("inf"), "sudden", "1 or more and finite", self.sudden)
        for name in ("bad_share", "near_share", "gate"):
            require_positive(name, getattr(self, name))
        require(0 <= self.pose_weight < float("inf"), "pose_weight", "0 or more and finite", self.pose_weight)
        require(0 <= self.sudden_share <= 1, "sudden_share", "0 to 1", self.sudden_share)
        for name in self.postures:
            require(name in POSTURES, "postures", f"names among {', '.join(POSTURES)}", name)
