"""From coarse to fine: how far residuals are believed, and how often data are associated anew."""

from dataclasses import dataclass
from typing import Literal

from torchhand.errors import require


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One step from coarse to fine.

    Lengths are of the hand's surroundings in space; observations in pictures take them at the hand's distance.
    """

    gross_m: float = 0.010
    """Distance beyond which a residual counts as gross, metres; above 0."""
    rounds: int = 2
    """Associations of data with the posed hand; 1 or more."""
    iterations: int = 3
    """Most steps of the optimiser after each association; 1 or more."""
    method: Literal["levenberg_marquardt", "gauss_newton", "gradient_descent"] = "levenberg_marquardt"
    """Levenberg-Marquardt takes steps only if they lower the cost; gauss_newton takes one damped step after each
    association without asking, which is twice as fast and enough near the pose; gradient_descent is for comparison and
    takes ten times the iterations."""
    until_arrived: bool = False
    """Whether the rounds of gauss_newton are the most that are taken: a hand has arrived after a step that promises no
    noticeable decrease of the cost, and stays; what that step brings is believed where no hand goes on."""
    pitch_px: int = 1
    """Pixels of the picture per pixel of a distance map; 1 or more."""
    thinning: int = 1
    """Every so manieth point of contours is compared, of the model's and of the picture's; 1 or more."""

    def __post_init__(self) -> None:
        require(0 < self.gross_m < float("inf"), "stage.gross_m", "above 0 and finite", self.gross_m)
        for name in ("rounds", "iterations", "pitch_px", "thinning"):
            require(getattr(self, name) >= 1, f"stage.{name}", "1 or more", getattr(self, name))
        methods = ("levenberg_marquardt", "gauss_newton", "gradient_descent")
        require(self.method in methods, "stage.method", f"one of {', '.join(methods)}", self.method)


Schedule = tuple[Stage, ...]
"""At least one stage; the last one decides about cost, status and covariance."""
