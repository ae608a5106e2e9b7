"""Settings of the fit of a hand to keypoints."""

import math
from dataclasses import dataclass, field

from torchhand.numerics import LevenbergMarquardtSettings

PRIORS = ("where_missing", "always", "never")


@dataclass(frozen=True, kw_only=True)
class KeypointFitSettings:
    """How far to trust keypoints, when to believe in a natural posture, and when to stop."""

    noise: float = 0.004
    """Standard deviation of a point in space along each axis, metres; above 0."""
    noise_px: float | None = None
    """Standard deviation of a point in a picture along each axis, px; above 0. Where it is None, `noise_share`."""
    noise_share: float = 0.025
    """The same as a share of the longer side of the box around the frame's points; above 0."""
    gross: float = 5.0
    """Points further off than this many standard deviations count for less (Huber); above 0, infinite for none."""
    prior: str = "auto"
    """When the natural posture counts: for the joints whose points are missing, always, or never. auto is
    where_missing in space, where a full set of points needs no belief that would only pull, and always in pictures."""
    least_points: int = 5
    """Frames with fewer points, or with all of them in one place, are not fitted; 4 or more."""
    is_typical: bool = True
    """Whether a fitted shape keeps the published anthropometric intervals besides its bounds (paper 000, 3.1)."""
    offset_std: float = 0.0
    """Spread of the constant offsets between the maker's keypoints and ours, metres, in the frames of the bones; one
    set for all frames, fitted together with the shape. 0 or more; 0 takes the keypoints as ours."""
    starts: int = 8
    """Starts per frame that are followed up for pictures; 1 or more."""
    rough_iterations: int = 25
    """From every start; 1 or more."""
    rounds: int = 2
    """How often pictures are begun anew with the shape found so far, where a shape is fitted; 1 or more."""
    chunk: int = 256
    """Frames whose derivatives are held at a time; 1 or more."""
    pose: LevenbergMarquardtSettings = field(
        default_factory=lambda: LevenbergMarquardtSettings(
            iterations=60, damping=1e-4, cost_tolerance=1e-7, cost_floor=1e-11
        )
    )
    """Of the poses at a given shape. The cost is half the squared distance in standard deviations."""
    shape: LevenbergMarquardtSettings = field(
        default_factory=lambda: LevenbergMarquardtSettings(iterations=20, damping=1e-3, cost_tolerance=1e-5)
    )
    """Of what all frames share."""

    def __post_init__(self) -> None:
        for name in ("noise", "noise_px", "noise_share"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ValueError(f"{name}: expected above 0 and finite, got {value!r}")
        if not self.gross > 0:
            raise ValueError(f"gross: expected above 0, got {self.gross!r}")
        if self.prior not in ("auto", *PRIORS):
            raise ValueError(f"prior: expected one of auto, {', '.join(PRIORS)}, got {self.prior!r}")
        if not 0 <= self.offset_std < math.inf:
            raise ValueError(f"offset_std: expected 0 or more and finite, got {self.offset_std!r}")
        for name, least in (("least_points", 4), ("starts", 1), ("rough_iterations", 1), ("rounds", 1), ("chunk", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name}: expected {least} or more, got {getattr(self, name)!r}")
