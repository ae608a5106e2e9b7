"""Settings of a tracker, and the presets by their method; configs/*.yaml hold differences from these."""

from dataclasses import dataclass, field
from typing import Literal

from torchhand.errors import require
from torchhand.fit.detect import FitSettings
from torchhand.fit.keypoints import KeypointSettings
from torchhand.hand import POSE_SPACES, POSTURES
from torchhand.image import WORKING_PIXELS, SilhouetteSettings
from torchhand.numerics import MotionModel
from torchhand.track.belief import NoiseSettings
from torchhand.track.extended import ExtendedUpdateSettings
from torchhand.track.multiview import RigSettings
from torchhand.track.scene import HealthSettings
from torchhand.track.unscented import UnscentedUpdateSettings

Method = Literal["contour", "distance", "hull"]


@dataclass(frozen=True, kw_only=True)
class TrackerSettings:
    """What a tracker is made of."""

    method: Method = "contour"
    """Update rule: unscented on edges, extended on registered segments, MAP in the hull of silhouettes."""
    update: UnscentedUpdateSettings | ExtendedUpdateSettings | None = field(default_factory=UnscentedUpdateSettings)
    """The rule's own settings; those of the hull are `rig`."""
    pose_space: str = "planar"
    """Free DOFs: a name of torchhand.hand.POSE_SPACES."""
    posture: str = "open"
    """Posture at the start of one camera: a name of torchhand.hand.POSTURES."""
    motion: MotionModel = field(default_factory=lambda: MotionModel(order=2, acceleration_decay_s=0.3))
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    points_per_generator: int = 10
    """Outline points on each side of a cone; 2 or more."""
    points_per_arc: int = 12
    """Outline points on each ellipsoid; 4 or more."""
    silhouette: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    """How the hand is told from its surroundings until its colours are learned: skin, background plate or chroma."""
    colour_update_every: int = 10
    """Frames of one camera that agree with the model from one update of the hand's colours to the next, as the light
    changes; 0 keeps those of the start."""
    health: HealthSettings = field(default_factory=HealthSettings)
    keypoints: KeypointSettings = field(default_factory=KeypointSettings)
    """Noise, correlation and smallest score of detected keypoints, where a detector gives some."""
    fit: FitSettings = field(default_factory=FitSettings)
    """Settings of the fit to the picture in which a hand is found."""
    learned_proposals: bool = True
    """Whether a trained network proposes hands in any posture to one pinhole camera, where the posture of the start is
    not found or leaves something unexplained."""
    learned_posture: bool = True
    """Whether that network also tells the joint angles and the direction of a hand that is followed by one pinhole
    camera, picture by picture; a hand that it sees from another side is in doubt."""
    rig: RigSettings = field(default_factory=RigSettings)
    """Several cameras: the hull of the silhouettes, in which a hand is found whatever the update rule."""
    shape_frames: int = 16
    """Frames of one camera, well spread, over which the proportions are fitted once a recording was followed, or while
    pictures come; a quarter of them only judge the result. 0 keeps the proportions of the first hand, as the presets do
    for methods with which it has not been measured."""
    smoothing_window_s: float = 0.0
    """How far a hand that was found anew is followed back, to correct the frames before, seconds; 0 or more."""
    max_pixels: int = WORKING_PIXELS
    """Pixels of a picture that is worked on: larger ones are reduced to as many, which is a little over full HD; an
    outline says no more of a hand in a larger picture. Where a hand is small in the picture of one camera, that is
    enlarged to no more than these. 10,000 or more."""
    check_side_px: int = 320
    """Longer side of the reduced pictures in which silhouettes are compared; 64 or more."""

    def __post_init__(self) -> None:
        require(self.pose_space in POSE_SPACES, "pose_space", f"one of {', '.join(POSE_SPACES)}", self.pose_space)
        require(self.posture in POSTURES, "posture", f"one of {', '.join(POSTURES)}", self.posture)
        for name, minimum in (
            ("points_per_generator", 2),
            ("points_per_arc", 4),
            ("colour_update_every", 0),
            ("shape_frames", 0),
            ("max_pixels", 10_000),
            ("check_side_px", 64),
        ):
            require(getattr(self, name) >= minimum, name, f"{minimum} or more", getattr(self, name))
        has_window = 0 <= self.smoothing_window_s < float("inf")
        require(has_window, "smoothing_window_s", "0 or more and finite", self.smoothing_window_s)


_CONTOUR = TrackerSettings()
_DISTANCE = TrackerSettings(
    method="distance",
    update=ExtendedUpdateSettings(),
    shape_frames=0,
    motion=MotionModel(order=1, velocity_decay_s=0.15),  # parameters and velocities (Ouhaddi and Horain 1998)
    noise=NoiseSettings(translation=4.0, rotation=20.0, angle=30.0),
)
_HULL = TrackerSettings(
    method="hull",
    update=None,
    shape_frames=0,
    pose_space="dof28",
    motion=MotionModel(order=1, velocity_decay_s=0.1),
    noise=NoiseSettings(translation=2.0, rotation=30.0, angle=120.0),
    silhouette=SilhouetteSettings(shaded_skin=0.5),
    health=HealthSettings(
        min_edges=0.0,
        found_overlap=0.70,
        edge_weight=0.5,
        memory=0.9,
        max_score_drop=0.05,
        max_unexplained=float("inf"),
        search_every=10,
        search_at_most_every=60,
        searches_when_failing=False,
    ),
    smoothing_window_s=1.0,
    check_side_px=160,
)

DEFAULTS: dict[str, TrackerSettings] = {"contour": _CONTOUR, "distance": _DISTANCE, "hull": _HULL}
"""Default settings by method."""
