"""Settings of several cameras: the hull of their silhouettes, and how a hand is found and fitted in it."""

from dataclasses import dataclass, field
from typing import Literal

from torchhand.errors import require, require_positive
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


@dataclass(frozen=True, kw_only=True)
class HullOctreeSettings:
    """How the hull is carved."""

    level: int = 7
    """Levels of the octree while a hand is followed; 1 to 10."""
    side: float | None = None
    """Side of the cube that is divided, metres; null: what all cameras see together."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of the cube where its side is given, world frame, metres."""
    tracked_side: float | None = 0.45
    """Side of a smaller cube about the hand while it is followed, metres; null: always the whole cube."""
    start_leaf: float = 0.004
    """Side of the finest octants in the whole cube, metres at most; above 0."""
    margin_px: int = 1
    """Pixels by which the projection of an octant is widened on all sides, as in `CarvingSettings`; 0 or more."""
    tolerated_views: int = 0
    """Views that may be wrong at every place, as in `CarvingSettings`; 0 or more."""
    min_views: int | None = None
    """Views in which the hand must appear; null: three quarters of those there are, at least two. Of a followed hand
    that leaves pictures, no more than show all about it."""

    def __post_init__(self) -> None:
        require(1 <= self.level <= 10, "rig.octree.level", "1 to 10", self.level)
        for name in ("side", "tracked_side", "start_leaf"):
            if getattr(self, name) is not None:
                require_positive(f"rig.octree.{name}", getattr(self, name))
        for name, lowest in (("margin_px", 0), ("tolerated_views", 0), ("min_views", 1)):
            value = getattr(self, name)
            require(value is None or value >= lowest, f"rig.octree.{name}", f"{lowest} or more", value)


@dataclass(frozen=True, kw_only=True)
class RigSettings:
    """A hand in the hull of the silhouettes of several cameras (Ueda et al. 2003)."""

    fitting: Literal["least_squares", "torque"] = "least_squares"
    """Method of the fit: least squares on both sides of skin and hull with prediction and filter, or the torques of
    Ueda et al. (2003)."""
    pose_space: str = "dof28"
    """Free DOFs: a name of torchhand.hand.POSE_SPACES."""
    octree: HullOctreeSettings = field(default_factory=HullOctreeSettings)
    contours: bool = True
    """Whether the edges of all views' silhouettes must touch the skin; if not, the hull's surface must be on it, which
    in part is volume that no hand fills."""
    hull: HullSettings = field(default_factory=lambda: HullSettings(rigidity_exponent=1.5))
    """Weights and sizes of the fit by least squares."""
    joints: JointPriorWeights = field(default_factory=lambda: JointPriorWeights(postures=0.5, posture_tail=3.0))
    """Weights of the priors on joint angles in the fit by least squares."""
    tracking: Schedule = TRACKING
    """Stages of the fit while a hand is followed."""
    tracking_vertices: int = 250
    """Vertices of the skin that must be inside the hull while a hand is followed; 1 or more."""
    search: Schedule = SEARCH
    """Stages of the fit from starts that are farther off, such as the last step of a search."""
    start: HullStartSettings = field(default_factory=HullStartSettings)
    """Poses and places from which a search without a guess begins."""
    torque: HullTorqueSettings = field(default_factory=HullTorqueSettings)
    """Step sizes and ends of the fit by torques."""
    shape: HullShapeSettings = field(default_factory=HullShapeSettings)
    """Rounds and weights of the fit of the proportions."""
    shape_posture_weight: float = 0.8
    """Weight of the posture prior in the fit of the proportions; 0 or more. The less each frame's posture may deviate,
    the more the frames tell of the proportions."""
    shape_frames: int = 8
    """Frames, evenly over the sequence, to which the proportions are fitted once where they are not given; 0 keeps
    those of the generic hand."""
    sizes: tuple[float, ...] = (1.0,)
    """Sizes of the generic hand that are tried before the proportions are known; above 0."""
    found_overlap: float = 0.70
    """Smallest overlap, mean over the views, with which a hand is taken as found; 0 to 1."""
    min_views: int = 2
    """Views with a silhouette that a frame needs; 2 or more. Of a followed hand that leaves pictures, no more than show
    all about it."""
    check_side_px: int = 160
    """Longer side of the reduced pictures in which silhouettes are compared; 64 or more."""

    def __post_init__(self) -> None:
        fittings = ("least_squares", "torque")
        require(self.fitting in fittings, "rig.fitting", " or ".join(fittings), self.fitting)
        require(self.pose_space in POSE_SPACES, "rig.pose_space", f"one of {', '.join(POSE_SPACES)}", self.pose_space)
        for name in ("tracking", "search"):
            require(len(getattr(self, name)) > 0, f"rig.{name}", "at least one stage", getattr(self, name))
        require(self.tracking_vertices >= 1, "rig.tracking_vertices", "1 or more", self.tracking_vertices)
        is_weight = 0 <= self.shape_posture_weight < float("inf")
        require(is_weight, "rig.shape_posture_weight", "0 or more and finite", self.shape_posture_weight)
        require(self.shape_frames >= 0, "rig.shape_frames", "0 or more", self.shape_frames)
        require(len(self.sizes) > 0 and min(self.sizes) > 0, "rig.sizes", "at least one, all above 0", self.sizes)
        require(0 <= self.found_overlap <= 1, "rig.found_overlap", "0 to 1", self.found_overlap)
        require(self.min_views >= 2, "rig.min_views", "2 or more", self.min_views)
        require(self.check_side_px >= 64, "rig.check_side_px", "64 or more", self.check_side_px)
