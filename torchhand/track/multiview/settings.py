"""Settings of the tracker of several cameras; configs/hull_*.yaml hold differences from these."""

from dataclasses import dataclass, field
from typing import Literal

from torchhand.fit import Schedule
from torchhand.fit.hull import (
    SEARCH,
    TRACKING,
    HullSettings,
    HullShapeSettings,
    HullStartSettings,
    HullTorqueSettings,
    JointPriorWeights,
)
from torchhand.hand import POSE_SPACES
from torchhand.image import SilhouetteSettings
from torchhand.numerics import MotionModel
from torchhand.track import NoiseSettings, require, require_positive


@dataclass(frozen=True, kw_only=True)
class HullOctreeSettings:
    """How the hull is carved."""

    level: int = 7
    """Levels of the octree while a hand is followed; 1 to 10."""
    side: float | None = None
    """Side of the cube that is divided, metres; null: what all cameras see together."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its centre where a side is given, world frame, metres."""
    follow: float | None = 0.75
    """Side of a smaller cube about the hand while it is followed, metres; null: always the whole cube."""
    start_leaf: float = 0.004
    """Side of the finest octants in the whole cube, metres at most; above 0."""
    margin_px: int = 1
    """As in `CarvingSettings`."""
    tolerated_views: int = 0
    """As in `CarvingSettings`: views that may be wrong at every place."""
    least_views: int | None = None
    """Views in which the hand must appear; null: three quarters of those there are, at least two."""

    def __post_init__(self) -> None:
        require(1 <= self.level <= 10, "octree.level", "1 to 10", self.level)
        for name in ("side", "follow", "start_leaf"):
            if getattr(self, name) is not None:
                require_positive(f"octree.{name}", getattr(self, name))
        for name, least in (("margin_px", 0), ("tolerated_views", 0), ("least_views", 1)):
            value = getattr(self, name)
            require(value is None or value >= least, f"octree.{name}", f"{least} or more", value)


@dataclass(frozen=True, kw_only=True)
class MultiViewLossSettings:
    """When a track is given up. Overlaps are means over the views, of intersection over union."""

    min_overlap: float = 0.60
    """Least overlap of the model's silhouettes with the pictures'; 0 to 1."""
    patience: int = 3
    """Frames in a row that may fail before the track is lost; 1 or more."""
    start_overlap: float = 0.70
    """Least overlap with which a hand is taken as found; 0 to 1."""
    doubt_drop: float = 0.05
    """A hand that explains less than usual by this much, in areas and edges of the silhouettes, is compared with other
    turns, postures and a fresh search; 0 to 1."""
    better_by: float = 0.02
    """By how much another fit must explain more, in areas and edges of the silhouettes, to take over; 0 to 1."""
    search_every: int = 10
    """Frames from one search without any guess to the next where the last one found a hand; 1 or more."""
    search_seldom: int = 60
    """The same where searches keep finding nothing; `search_every` or more."""
    fewest_views: int = 2
    """Views with a silhouette that a frame needs; 2 or more."""

    def __post_init__(self) -> None:
        for name in ("min_overlap", "start_overlap", "doubt_drop", "better_by"):
            require(0 <= getattr(self, name) <= 1, f"loss.{name}", "0 to 1", getattr(self, name))
        for name, least in (("patience", 1), ("search_every", 1), ("fewest_views", 2)):
            require(getattr(self, name) >= least, f"loss.{name}", f"{least} or more", getattr(self, name))
        is_rarer = self.search_seldom >= self.search_every
        require(is_rarer, "loss.search_seldom", "search_every or more", self.search_seldom)


@dataclass(frozen=True, kw_only=True)
class MultiViewSettings:
    """The tracker of Ueda et al. 2003."""

    method: Literal["hull"] = "hull"
    fitting: Literal["least_squares", "torque"] = "least_squares"
    """Method: both sides of skin and hull with prediction and filter, or the paper's torques."""
    pose_space: str = "dof28"
    """Free DOFs: a name of torchhand.hand.POSE_SPACES."""
    silhouette: SilhouetteSettings = field(default_factory=lambda: SilhouetteSettings(shaded_skin=0.5))
    """How the hand is told from its surroundings in every view where no masks are given."""
    octree: HullOctreeSettings = field(default_factory=HullOctreeSettings)
    contours: bool = True
    """The edges of all views' silhouettes must touch the skin; without them the hull's surface must be on it, which in
    part is volume that no hand fills."""
    hull: HullSettings = field(default_factory=lambda: HullSettings(rigidity_exponent=1.5))
    """Weights and sizes of the fit by least squares."""
    joints: JointPriorWeights = field(default_factory=lambda: JointPriorWeights(postures=0.5, posture_tail=3.0))
    """What is believed of joint angles in that fit."""
    tracking: Schedule = TRACKING
    """Stages of the fit while a hand is followed."""
    tracking_vertices: int = 250
    """Vertices of the skin that must be inside the hull while a hand is followed; 1 or more."""
    search: Schedule = SEARCH
    """Stages of the fit from starts that are farther off, such as the last step of a search."""
    start: HullStartSettings = field(default_factory=HullStartSettings)
    """Where a hand is looked for."""
    torque: HullTorqueSettings = field(default_factory=HullTorqueSettings)
    """Steps of the fit by torques."""
    shape: HullShapeSettings = field(default_factory=HullShapeSettings)
    """Rounds of the fit of the proportions."""
    shape_posture_weight: float = 0.8
    """Weight of the likely postures in that fit; 0 or more. The less each frame's posture may deviate, the more the
    frames tell of the proportions."""
    shape_frames: int = 12
    """Frames, evenly over the sequence, to which the proportions are fitted once where they are not given; 0 keeps
    those of the generic hand."""
    sizes: tuple[float, ...] = (1.0,)
    """Sizes of the generic hand that are tried before the proportions are known; above 0."""
    motion: MotionModel = field(default_factory=lambda: MotionModel(order=1, velocity_decay_s=0.1))
    noise: NoiseSettings = field(default_factory=lambda: NoiseSettings(translation=2.0, rotation=30.0, angle=120.0))
    loss: MultiViewLossSettings = field(default_factory=MultiViewLossSettings)
    look_back_s: float = 1.0
    """How far a hand that was found anew is followed back, to correct the frames before, seconds; 0 or more."""
    check_side_px: int = 160
    """Longer side of the reduced pictures in which silhouettes are compared; 64 or more."""

    def __post_init__(self) -> None:
        require(self.method == "hull", "method", "hull", self.method)
        fittings = ("least_squares", "torque")
        require(self.fitting in fittings, "fitting", " or ".join(fittings), self.fitting)
        require(self.pose_space in POSE_SPACES, "pose_space", f"one of {', '.join(POSE_SPACES)}", self.pose_space)
        for name in ("tracking", "search"):
            require(len(getattr(self, name)) > 0, name, "at least one stage", getattr(self, name))
        require(self.tracking_vertices >= 1, "tracking_vertices", "1 or more", self.tracking_vertices)
        is_weight = 0 <= self.shape_posture_weight < float("inf")
        require(is_weight, "shape_posture_weight", "0 or more and finite", self.shape_posture_weight)
        require(self.shape_frames >= 0, "shape_frames", "0 or more", self.shape_frames)
        require(len(self.sizes) > 0 and min(self.sizes) > 0, "sizes", "at least one, all above 0", self.sizes)
        require(0 <= self.look_back_s < float("inf"), "look_back_s", "0 or more and finite", self.look_back_s)
        require(self.check_side_px >= 64, "check_side_px", "64 or more", self.check_side_px)
