"""One trial of a designed study: everything that factors can vary, at its plain value."""

from dataclasses import dataclass, field
from typing import Literal

from torchhand.simulate import SkinTone
from torchhand.study.designed.perturbations import Perturbation, UniformPerturbation

ObservationKind = Literal["contour", "distance_map", "outline", "points", "all"]
"""contour: points of the picture's contour looked for on the model's outline. distance_map: the model's outline on the
distance map of the picture's contour, and its inner lines on dark valleys (Ouhaddi and Horain 1998). outline: both.
points: detected keypoints. all: the three."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """How a hand is seen, with what it is registered, and from where. A factor changes one of these."""

    perturbation: Perturbation = field(default_factory=UniformPerturbation)
    """How far starts are off."""
    perturbation_size: float = 1.0
    """Factor of that; 0 or more."""
    frame_rate: float = 30.0
    """Pictures per second of a moving hand whose start is the pose of the picture before: the perturbation is that of
    30 pictures per second, and grows as the time between two; above 0."""
    hypotheses: int = 1
    """Starts of a trial, of which the one that explains the observations best is its result; 1 or more."""
    observation: ObservationKind = "outline"
    cameras: int = 1
    """Cameras around the hand, 45 degrees apart; 1 to 8."""
    missing_views: float = 0.0
    """Probability that a camera sees nothing; 0 to 1."""
    noise: float = 2.0
    """Standard deviation of the picture's noise, grey levels of 255."""
    blur_px: float = 0.0
    """Standard deviation of the picture's blur, px. The silhouette is what a threshold finds in the blurred picture."""
    mask_noise_px: float = 0.0
    """Standard deviation of the silhouette's boundary, px."""
    occlusion: float = 0.0
    """Share of the silhouette that a disc hides, as one of the background's colour would, and the points behind it."""
    skin: SkinTone = "light"
    ambient: float = 0.45
    """Share of the light that comes from everywhere."""
    dropout: float = 0.0
    """Probability that the detector misses a point."""
    point_std_mm: float = 5.0
    """Standard deviation of detected points along each axis, mm at the hand."""
    shape_spread: float = 0.0
    """How far the hand's shape is from the one that is registered, standard deviations of the population."""
    focal_error: float = 0.0
    """Error of the focal lengths that are believed, share of the true ones."""
    centre_error_px: float = 0.0
    """Error of the principal point that is believed, px along x."""
    camera_turn_deg: float = 0.0
    """Standard deviation of the believed orientation of every camera but the first, about each axis."""

    @property
    def scale(self) -> float:
        """Factor of the perturbation."""
        return self.perturbation_size * 30.0 / self.frame_rate
