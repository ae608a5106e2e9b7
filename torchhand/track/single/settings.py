"""How a hand in a single picture is registered, and when it is believed."""

import math
from dataclasses import dataclass, field

from torchhand.errors import require
from torchhand.fit.keypoints import KeypointSettings


@dataclass(frozen=True, kw_only=True)
class SinglePoseSettings:
    """What one picture tells of a hand, and when it is believed."""

    keypoints: KeypointSettings = field(default_factory=KeypointSettings)
    """How far detected points are believed."""
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

    def __post_init__(self) -> None:
        for name in ("min_overlap", "min_edges", "alone_overlap", "alone_edges"):
            require(0 <= getattr(self, name) <= 1, name, "0 to 1", getattr(self, name))
        require(self.alone_odds < math.inf, "alone_odds", "a number below infinity", self.alone_odds)
        require(self.max_side_px >= 64, "max_side_px", "64 or more", self.max_side_px)
