"""The trackers there are, by the name that a configuration gives as its method."""

from jaxtyping import Float
from torch import Tensor

from torchhand.fit.detect import StartPoints
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.image import BackgroundPlate
from torchhand.track import ContourTrackerSettings
from torchhand.track.extended import DistanceTracker, DistanceTrackerSettings
from torchhand.track.unscented import ContourTracker

AnySettings = ContourTrackerSettings | DistanceTrackerSettings
AnyTracker = ContourTracker | DistanceTracker

DEFAULTS: dict[str, AnySettings] = {
    settings.method: settings for settings in (ContourTrackerSettings(), DistanceTrackerSettings())
}
"""Default settings by method."""


def tracker_of(
    kinematics: HandKinematics,
    camera: Camera,
    frames_per_second: float,
    settings: AnySettings,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    start_points: StartPoints | None = None,
    plate: BackgroundPlate | None = None,
) -> AnyTracker:
    """The tracker that some settings are for; arguments and errors as `HandTracker`."""
    given = (kinematics, camera, frames_per_second)
    if isinstance(settings, DistanceTrackerSettings):
        return DistanceTracker(*given, settings, shape=shape, start_points=start_points, plate=plate)
    return ContourTracker(*given, settings, shape=shape, start_points=start_points, plate=plate)
