"""What a tracker makes of one picture."""

from dataclasses import dataclass

from jaxtyping import Bool
from torch import Tensor

from torchhand.track.state import TrackerState


@dataclass(frozen=True, kw_only=True)
class SeenContour:
    """Which points of the contour the camera sees, and which of these lie on the silhouette."""

    visible: Bool[Tensor, "points"]
    outer: Bool[Tensor, "visible_points"]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A state after a measurement update, and how well the picture bears it out."""

    state: TrackerState
    found: float = 0.0
    """Share of the outer contour points in the picture with an accepted edge."""
    inside: float = 0.0
    """Share of the visible contour points in the picture."""
    nis: float | None = 0.0
    """Normalised innovation squared per accepted measurement; None where it means nothing."""
    seen: SeenContour | None = None
    """What a further pass over the same picture need not judge again."""
