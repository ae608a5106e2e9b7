"""Settings of the fit of a hand to keypoints."""

import math
from dataclasses import dataclass

from torchhand.errors import require, require_positive
from torchhand.fit.keypoints.relative import DEPTH_STD_M, STD_M

PRIORS = ("auto", "where_missing", "always", "never")


@dataclass(frozen=True, kw_only=True)
class KeypointFitSettings:
    """How far to trust keypoints, and when to believe in a natural posture."""

    noise: float = 0.004
    """Standard deviation of a point in space along each axis, metres; above 0."""
    noise_px: float | None = None
    """Standard deviation of a point in a picture along each axis, px; above 0. Where it is None, `noise_fraction`."""
    noise_fraction: float = 0.025
    """Standard deviation of a point in a picture as a share of the longer side of the box around the frame's points;
    above 0."""
    relative_noise: float = STD_M
    """Standard deviation of a point in space beside pictures (`SeenKeypoints.points`) across the line of sight, metres,
    where all points of a hand count; above 0."""
    relative_noise_depth: float = DEPTH_STD_M
    """The same along the line of sight, metres; above 0."""
    gross: float = 5.0
    """Standard deviations beyond which points count for less (Huber); above 0, infinite for none."""
    prior: str = "auto"
    """Use of the natural posture: for the joints whose points are missing, always, or never. auto is where_missing in
    space, where a full set of points needs no belief that would only pull, and always in pictures."""
    min_points: int = 5
    """Frames with fewer points, or with all of them in one place, are not fitted; 4 or more."""
    offset_std: float = 0.0
    """Spread of the constant offsets between the maker's keypoints and ours, metres, in the frames of the bones; one
    set for all frames, fitted together with the shape. 0 or more; 0 takes the keypoints as ours."""
    is_recording: bool = False
    """Whether frames are those of a recording, in their order and at equal distances in time. Poses are then smoothed,
    short gaps are filled, and cameras may be late."""
    lag_std: float = 1.0
    """Spread of the lags of cameras behind the first one in a recording, frames; fitted together with the shape, at
    most 3. 0 or more; 0 takes the cameras as synchronous."""
    max_gap: int = 10
    """Longest run of frames without enough points in a recording that is filled from its neighbours; 0 or more."""
    fit_scale: bool = False
    """Whether points in space are in an unknown unit, which is then fitted; hand length and breadth are held."""
    starts: int = 8
    """Starts per frame that are followed up for pictures; 1 or more."""

    def __post_init__(self) -> None:
        for name in ("noise", "noise_px", "noise_fraction", "relative_noise", "relative_noise_depth"):
            if (value := getattr(self, name)) is not None:
                require_positive(name, value)
        require(self.gross > 0, "gross", "above 0", self.gross)
        require(self.prior in PRIORS, "prior", f"one of {', '.join(PRIORS)}", self.prior)
        for name in ("offset_std", "lag_std"):
            require(0 <= getattr(self, name) < math.inf, name, "0 or more and finite", getattr(self, name))
        for name, minimum in (("min_points", 4), ("starts", 1), ("max_gap", 0)):
            require(getattr(self, name) >= minimum, name, f"{minimum} or more", getattr(self, name))
