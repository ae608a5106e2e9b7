"""Settings of the fit of a hand to keypoints."""

import math
from dataclasses import dataclass

from torchhand.errors import require, require_positive

PRIORS = ("auto", "where_missing", "always", "never")


@dataclass(frozen=True, kw_only=True)
class KeypointFitSettings:
    """How far to trust keypoints, and when to believe in a natural posture."""

    noise: float = 0.004
    """Standard deviation of a point in space along each axis, metres; above 0."""
    noise_px: float | None = None
    """Standard deviation of a point in a picture along each axis, px; above 0. Where it is None, a fortieth of the
    longer side of the box around the frame's points."""
    gross: float = 5.0
    """Standard deviations beyond which points count for less (Huber); above 0, infinite for none."""
    prior: str = "auto"
    """Use of the natural posture: for the joints whose points are missing, always, or never. auto is where_missing in
    space, where a full set of points needs no belief that would only pull, and always in pictures."""
    offset_std: float = 0.0
    """Spread of the constant offsets between the maker's keypoints and ours, metres, in the frames of the bones; one
    set for all frames, fitted together with the shape. 0 or more; 0 takes the keypoints as ours."""
    is_recording: bool = False
    """Whether frames are those of a recording, in their order and at equal distances in time. Poses are then smoothed,
    short gaps are filled, and cameras may be late."""
    fit_scale: bool = False
    """Whether points in space are in an unknown unit, which is then fitted; hand length and breadth are held."""
    starts: int = 8
    """Starts per frame that are followed up for pictures; 1 or more."""

    def __post_init__(self) -> None:
        require_positive("noise", self.noise)
        if self.noise_px is not None:
            require_positive("noise_px", self.noise_px)
        require(self.gross > 0, "gross", "above 0", self.gross)
        require(self.prior in PRIORS, "prior", f"one of {', '.join(PRIORS)}", self.prior)
        require(0 <= self.offset_std < math.inf, "offset_std", "0 or more and finite", self.offset_std)
        require(self.starts >= 1, "starts", "1 or more", self.starts)
