"""The trackers there are, by the name that a configuration gives as its method."""

from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import Hand, HandKinematics
from torchhand.image import BackgroundPlate
from torchhand.track.contour_tracker import ContourTracker
from torchhand.track.distance_settings import DistanceTrackerSettings
from torchhand.track.distance_tracker import DistanceTracker
from torchhand.track.settings import ContourTrackerSettings
from torchhand.track.start import StartPoints

AnySettings = ContourTrackerSettings | DistanceTrackerSettings
AnyTracker = ContourTracker | DistanceTracker

DEFAULTS: dict[str, AnySettings] = {
    settings.method: settings for settings in (ContourTrackerSettings(), DistanceTrackerSettings())
}
"""Default settings by method."""


def tracker_of(
    hand: Hand | HandKinematics,
    camera: Camera,
    frames_per_second: float,
    settings: AnySettings,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    start_points: StartPoints | None = None,
    plate: BackgroundPlate | None = None,
) -> AnyTracker:
    """The tracker that some settings are for; arguments and errors as `HandTracker`."""
    given = (hand, camera, frames_per_second)
    if isinstance(settings, DistanceTrackerSettings):
        return DistanceTracker(*given, settings, shape=shape, start_points=start_points, plate=plate)
    return ContourTracker(*given, settings, shape=shape, start_points=start_points, plate=plate)
