"""The contour tracker of paper 003: predict, project, find edges along normals, update; notice when it is lost."""

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import Hand, HandKinematics
from torchhand.image import BackgroundPlate
from torchhand.numerics import Gaussian
from torchhand.track.appearance import grey
from torchhand.track.measured import Measured
from torchhand.track.measurement import ContourMeasurement, Planes
from torchhand.track.prior import posture_prior
from torchhand.track.settings import ContourTrackerSettings
from torchhand.track.start import Start, StartPoints
from torchhand.track.state import Estimate, Memory, TrackerState
from torchhand.track.tracker import HandTracker

__all__ = ["ContourTracker", "Estimate", "Memory", "TrackerState"]

_SETTLING = 4  # measurement updates on the starting picture


class ContourTracker(HandTracker[ContourTrackerSettings]):
    """Follows one hand of a known side by edges along its contour; see `HandTracker`."""

    def __init__(
        self,
        hand: Hand | HandKinematics,
        camera: Camera,
        frames_per_second: float,
        settings: ContourTrackerSettings | None = None,
        *,
        shape: Float[Tensor, "shape"] | None = None,
        start_points: StartPoints | None = None,
        plate: BackgroundPlate | None = None,
    ) -> None:
        """As `HandTracker`."""
        s = settings or ContourTrackerSettings()
        super().__init__(hand, camera, frames_per_second, s, shape=shape, start_points=start_points, plate=plate)
        self._measurement = ContourMeasurement(
            settings=s,
            camera=self.camera,
            space=self.space,
            table=self.table,
            prior=posture_prior(self.space, s.prior),
            skeleton=self.kinematics.skeleton,
        )

    def _settle(self, state: TrackerState, start: Start, image: Tensor, probability: Tensor) -> Measured:
        spread = state.belief.covariance
        projector, _ = self._projectors_of(start.fit.shape)
        planes = self._planes(image, probability)
        settled = Measured(state=state)
        for _ in range(_SETTLING):
            belief = Gaussian(settled.state.belief.mean, spread)
            settled = self._measurement.update(replace(settled.state, belief=belief), projector, planes)
        return settled

    def _measure(self, state: TrackerState, shape: Tensor, image: Tensor, probability: Tensor) -> Measured:
        projector, _ = self._projectors_of(shape)
        planes = self._planes(image, probability)
        measured = Measured(state=self._predicted(state))
        for _ in range(self.settings.passes):
            measured = self._measurement.update(measured.state, projector, planes, measured.seen)
        return measured

    def _planes(self, image: Tensor, probability: Tensor) -> Planes:
        s = self.settings
        has_inner = s.inner_weight > 0
        luminance = grey(image) if s.edges_in == "grey" or has_inner else None
        outer = luminance if s.edges_in == "grey" and luminance is not None else probability
        return Planes(outer=outer, inner=luminance if has_inner else None)
