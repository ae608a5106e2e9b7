"""How a hand in a single picture is registered, and when it is believed."""

import math
from dataclasses import dataclass, field, replace

from torchhand.errors import require
from torchhand.fit import Schedule
from torchhand.fit.contour import SEARCH, ContourSettings
from torchhand.fit.keypoints import KeypointSettings
from torchhand.hand import POSE_SPACES

_FINEST_M = 0.0075
"""Gross distance of the finest stage: with less, a finger that is not covered at all costs next to nothing."""
_OUTLINE_WORTH = 20.0
"""Independent measurements that an outline is worth: a third of what it is to a tracker, whose proportions are the
person's. Beside a detector's points 60 lose what the points tell of bent fingers: on 30 stills of a hand the flexion
error is 7.6° with 60 and 7.0° with 20."""


@dataclass(frozen=True, kw_only=True)
class SinglePoseSettings:
    """What one picture tells of a hand, and when it is believed."""

    pose_space: str = "dof27"
    """Free DOFs: a name of torchhand.hand.POSE_SPACES."""
    contour: ContourSettings = field(
        default_factory=lambda: ContourSettings(
            contour_std_fraction=0.25, contour_weight=_OUTLINE_WORTH, coverage_weight=_OUTLINE_WORTH
        )
    )
    """Weights of contours, coverage and valleys."""
    keypoints: KeypointSettings = field(default_factory=KeypointSettings)
    """How far detected points are believed."""
    schedule: Schedule = (*SEARCH[:-1], replace(SEARCH[-1], gross_m=_FINEST_M))
    """Registration from coarse to fine; the first stage is that of all hypotheses, the others those of the best."""
    finalists: int = 4
    """Hypotheses that are registered to the end; 1 or more."""
    fits_shape: bool = True
    """Whether the proportions that an outline shows are fitted where they are not known."""
    min_overlap: float = 0.6
    """Smallest intersection over union of the hand's and the picture's silhouettes with which a hand is believed that
    detected keypoints bear out; 0 to 1."""
    min_edges: float = 0.4
    """Smallest share of the picture's contour, on the fingers' side of the wrist, on which such a hand's lies; 0 to
    1."""
    alone_overlap: float = 0.75
    """The same as `min_overlap` of a hand that its outline alone tells of; 0 to 1."""
    alone_edges: float = 0.65
    """The same as `min_edges` of a hand that its outline alone tells of; 0 to 1."""
    alone_odds: float = -0.662
    """Smallest logarithm of the odds that such a hand is the right one, by all that the picture says for and against;
    minus infinity asks nothing. About 10 % of the pictures without a hand that the model was fitted to reach these
    (evidence.json)."""
    max_side_px: int = 640
    """Larger pictures are reduced to this longer side for the work; 64 or more."""
    points_per_generator: int = 10
    """Outline points on each side of a cone; 2 or more."""
    points_per_arc: int = 12
    """Outline points on each ellipsoid; 4 or more."""

    def __post_init__(self) -> None:
        require(self.pose_space in POSE_SPACES, "pose_space", f"one of {', '.join(POSE_SPACES)}", self.pose_space)
        for name in ("min_overlap", "min_edges", "alone_overlap", "alone_edges"):
            require(0 <= getattr(self, name) <= 1, name, "0 to 1", getattr(self, name))
        require(self.alone_odds < math.inf, "alone_odds", "a number below infinity", self.alone_odds)
        counts = (("finalists", 1), ("max_side_px", 64), ("points_per_generator", 2), ("points_per_arc", 4))
        for name, minimum in counts:
            require(getattr(self, name) >= minimum, name, f"{minimum} or more", getattr(self, name))
