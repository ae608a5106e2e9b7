"""Settings of the trackers in common, and those of the contour tracker; configs/*.yaml hold differences from these."""

import math
from dataclasses import dataclass, field
from typing import Literal

from torchhand.fit.detect import FitSettings
from torchhand.hand import POSE_SPACES, POSTURES
from torchhand.image import EdgeSettings, SilhouetteSettings
from torchhand.numerics import MotionModel, UnscentedSettings


def require(condition: bool, name: str, expected: str, got: object) -> None:
    if not condition:
        raise ValueError(f"{name}: expected {expected}, got {got!r}")


def require_positive(name: str, value: float) -> None:
    require(0 < value < math.inf, name, "above 0 and finite", value)


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """How freely the hand moves: roots of the spectral densities that drive the motion model, one per kind of DOF.

    In (unit) / s^(order + 1/2): with order 2, m s⁻²·⁵ and rad s⁻²·⁵; with order 0, m s⁻⁰·⁵ and rad s⁻⁰·⁵.
    """

    translation: float = 30.0
    """Translations of the root; 0 or more."""
    rotation: float = 150.0
    """Rotations of the root; 0 or more."""
    angle: float = 300.0
    """Joint angles; 0 or more."""

    def __post_init__(self) -> None:
        for name in ("translation", "rotation", "angle"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"noise.{name}", "0 or more and finite", value)


@dataclass(frozen=True, kw_only=True)
class PriorSettings:
    """Weak beliefs about posture, used as measurements at every frame where fingers are free."""

    rest_std_rad: float = 1.0
    """Joint angles about those of the start; above 0."""
    side_std_rad: float = 0.12
    """Abductions and twists about those of the start; above 0."""
    tie_std_rad: float = 0.25
    """Flexion of the end joint about two thirds of that of the middle joint (paper 000, equation 1); above 0."""
    tilt_std_rad: float = 0.6
    """Rotation out of the picture's plane since the start; above 0."""

    def __post_init__(self) -> None:
        for name in ("rest_std_rad", "side_std_rad", "tie_std_rad", "tilt_std_rad"):
            require_positive(f"prior.{name}", getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class LossSettings:
    """When a track is given up."""

    min_overlap: float = 0.60
    """Least intersection over union of the model's and the picture's silhouette; 0 to 1, 0 switches the test off."""
    min_found: float = 0.40
    """Least share of the outer contour's points with an accepted edge; 0 to 1."""
    min_inside: float = 0.35
    """Least share of the contour's points inside the picture; 0 to 1."""
    patience: int = 3
    """Frames in a row that may fail before the track is lost; 1 or more."""
    start_overlap: float = 0.80
    """Least overlap with which a hand is taken as found; 0 to 1."""
    doubt_drop: float = 0.06
    """An overlap that is lower than at the start by this much has the track compared with a fresh search for the
    posture of the start; 0 to 1."""
    doubt_unexplained: float = 0.012
    """More area of the picture's hand than this outside the model, in pieces as thick as a finger and in squares of the
    hand's length, has the same effect; 0 or more."""
    better_by: float = 0.02
    """By how much the fresh search must overlap better to take over; 0 to 1."""
    turned_by: float = 0.1
    """The same where it shows the hand's other side, which a hand seldom turns from one picture to the next; 0 to 1."""
    search_every: int = 5
    """Frames from one such search to the next; 1 or more."""

    def __post_init__(self) -> None:
        for name in ("min_overlap", "min_found", "min_inside", "start_overlap", "doubt_drop", "better_by", "turned_by"):
            require(0 <= getattr(self, name) <= 1, f"loss.{name}", "0 to 1", getattr(self, name))
        require(self.doubt_unexplained >= 0, "loss.doubt_unexplained", "0 or more", self.doubt_unexplained)
        for name in ("patience", "search_every"):
            require(getattr(self, name) >= 1, f"loss.{name}", "1 or more", getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class LightSettings:
    """How the colours learned at the start follow changing light."""

    every: int = 10
    """Frames that agree with the model from one lesson to the next; 0 keeps the colours of the start."""
    keep: float = 0.7
    """Share of what is known of a colour that outlasts a lesson with that colour in it; 0 to 1."""

    def __post_init__(self) -> None:
        require(self.every >= 0, "light.every", "0 or more", self.every)
        require(0 <= self.keep <= 1, "light.keep", "0 to 1", self.keep)


@dataclass(frozen=True, kw_only=True)
class TrackerSettings:
    """What every tracker needs."""

    method: str
    """Which tracker."""
    pose_space: str = "planar"
    """Free DOFs: a name of torchhand.hand.POSE_SPACES."""
    posture: str = "open"
    """Posture at the start: a name of torchhand.hand.POSTURES."""
    motion: MotionModel = field(default_factory=lambda: MotionModel(order=2, acceleration_decay_s=0.3))
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    points_per_generator: int = 10
    """Outline points on each side of a cone; 2 or more."""
    points_per_arc: int = 12
    """Outline points on each ellipsoid; 4 or more."""
    silhouette: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    """How the hand is told from its surroundings until its colours are learned: skin, background plate or chroma."""
    light: LightSettings = field(default_factory=LightSettings)
    loss: LossSettings = field(default_factory=LossSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    check_side_px: int = 320
    """Longer side of the reduced picture in which silhouettes are compared; 64 or more."""

    def __post_init__(self) -> None:
        require(self.pose_space in POSE_SPACES, "pose_space", f"one of {', '.join(POSE_SPACES)}", self.pose_space)
        require(self.posture in POSTURES, "posture", f"one of {', '.join(POSTURES)}", self.posture)
        for name, least in (("points_per_generator", 2), ("points_per_arc", 4), ("check_side_px", 64)):
            require(getattr(self, name) >= least, name, f"{least} or more", getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class ContourTrackerSettings(TrackerSettings):
    """Paper 003's tracker."""

    method: Literal["contour"] = "contour"
    """The contour tracker."""
    edges_in: Literal["colour", "grey"] = "colour"
    """Picture in which the outer contour is searched: probability of the hand's colours, or grey levels (the paper)."""
    unscented: UnscentedSettings = field(default_factory=UnscentedSettings)
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
    search_share: float = 0.06
    """Half length of the edge search as a share of the hand's length in the picture; above 0."""
    passes: int = 1
    """Measurement updates per frame with fresh edges, each with its share of the weight; 1 or more."""
    prior: PriorSettings = field(default_factory=PriorSettings)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.method == "contour", "method", "contour", self.method)
        require(self.edges_in in ("colour", "grey"), "edges_in", "colour or grey", self.edges_in)
        for name in ("edge_std_px", "gate", "search_share"):
            require_positive(name, getattr(self, name))
        require(self.passes >= 1, "passes", "1 or more", self.passes)
        is_weight = 0 <= self.inner_weight < math.inf
        require(is_weight, "inner_weight", "0 or more and finite", self.inner_weight)
