"""Settings of several cameras: the hull of their silhouettes, and how a hand is found and fitted in it."""

from dataclasses import dataclass, field
from typing import Literal

from torchhand.errors import require, require_positive
from torchhand.fit.hull import (
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
    """Free DOFs of the hands that are proposed to other update rules, a name of torchhand.hand.POSE_SPACES; a hand that
    is followed in the hull has those of the tracker's `pose_space`."""
    octree: HullOctreeSettings = field(default_factory=HullOctreeSettings)
    hull: HullSettings = field(default_factory=lambda: HullSettings(rigidity_exponent=1.5))
    """Weights and sizes of the fit by least squares."""
    joints: JointPriorWeights = field(default_factory=lambda: JointPriorWeights(postures=0.5, posture_tail=3.0))
    """Weights of the priors on joint angles in the fit by least squares."""
    tracking_vertices: int = 250
    """Vertices of the skin that must be inside the hull while a hand is followed; 1 or more."""
    start: HullStartSettings = field(default_factory=HullStartSettings)
    """Poses and places from which a search without a guess begins."""
    torque: HullTorqueSettings = field(default_factory=HullTorqueSettings)
    """Step sizes and ends of the fit by torques."""
    shape: HullShapeSettings = field(default_factory=HullShapeSettings)
    """Rounds and sizes of the fit of the proportions."""
    shape_frames: int = 8
    """Frames, evenly over the sequence, to which the proportions are fitted once where they are not given; 0 keeps
    those of the generic hand."""
    min_views: int = 2
    """Views with a silhouette that a frame needs; 2 or more. Of a followed hand that leaves pictures, no more than show
    all about it."""

    def __post_init__(self) -> None:
        fittings = ("least_squares", "torque")
        require(self.fitting in fittings, "rig.fitting", " or ".join(fittings), self.fitting)
        require(self.pose_space in POSE_SPACES, "rig.pose_space", f"one of {', '.join(POSE_SPACES)}", self.pose_space)
        require(self.tracking_vertices >= 1, "rig.tracking_vertices", "1 or more", self.tracking_vertices)
        require(self.shape_frames >= 0, "rig.shape_frames", "0 or more", self.shape_frames)
        require(self.min_views >= 2, "rig.min_views", "2 or more", self.min_views)
