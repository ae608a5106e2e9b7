"""What one camera tells of a hand in single frames of a recording, as observations of a fit.

Contours, detected keypoints, and the posture that a network sees.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from jaxtyping import Float
from torch import Tensor

from torchhand.fit import (
    ConstraintPrior,
    FrameObservations,
    Observation,
    PosturePrior,
    PostureResiduals,
    Problem,
    Schedule,
)
from torchhand.fit.contour import ContourObservation, ContourSettings, picture_contours
from torchhand.fit.keypoints import KeypointSettings
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose, HandPrior, PoseConstraints
from torchhand.image import clean, fill_holes, touching
from torchhand.track.belief import HandMotion
from torchhand.track.extended import ExtendedUpdateSettings
from torchhand.track.scene import Scene, learned_observations, scene_keypoints, seen_posture
from torchhand.track.unscented import UnscentedUpdateSettings
from torchhand.view import HandProjector, OutlineTable, PrimitiveContours

_HOLE_PX = 50  # largest hole of a silhouette that is filled, square px


@dataclass(frozen=True, kw_only=True)
class SeenFrame:
    """What is known of the hand in one frame."""

    pose: HandPose
    observations: tuple[Observation, ...]

    @property
    def kinds(self) -> tuple[type, ...]:
        """Kinds of observations, in their order."""
        return tuple(type(one) for one in self.observations)


@dataclass(frozen=True, kw_only=True)
class FrameFit:
    """The fit of poses to frames of one camera: what these have in common."""

    kinematics: HandKinematics
    """float64"""
    camera: Camera
    """In whose frame poses are."""
    motion: HandMotion
    """Of the tracker beside which is fitted: its pose space."""
    table: OutlineTable
    """Which points of a hand's outline are compared with contours."""
    keypoints: KeypointSettings
    has_network: bool
    """Whether a network tells the posture in every frame."""
    shape: Float[Tensor, "shape"]
    """Proportions of the hand."""
    schedule: Schedule
    """Stages of the fit."""
    contours: ContourSettings

    def seen(self, scene: Scene, pose: HandPose) -> SeenFrame | None:
        """The observations of a scene about the hand near a pose () with a zero rotation vector; None where nothing of
        its contour is seen."""
        outline = self.contour(scene, pose)
        if outline is None:
            return None
        found: list[Observation] = [outline]
        if self.has_network:
            seen = seen_posture(scene, self.camera, self.kinematics, pose, self.shape)
            found += () if seen is None else learned_observations(seen, pose)
        found += scene_keypoints(scene, (self.camera,), self.kinematics, self.keypoints).observations
        return SeenFrame(pose=pose, observations=tuple(found))

    def contour(self, scene: Scene, pose: HandPose) -> ContourObservation | None:
        """The contour of the silhouette that a hand touches."""
        plane = scene.plane(0)
        if plane is None:
            return None
        projector = HandProjector(self.kinematics, self.camera, self.shape)
        mask = fill_holes(touching(clean(plane > 0.5), projector.silhouette(pose.dofs, pose.reference)), _HOLE_PX)
        picture = picture_contours(mask, self.schedule, self.contours, image=scene.views[0].image)
        if picture.is_empty:
            return None
        return ContourObservation(
            picture=picture, contours=PrimitiveContours(projector, self.table), settings=self.contours
        )

    def problem(self, frames: Sequence[SeenFrame]) -> Problem:
        """The poses of some frames as one problem, the shape known."""
        together = zip(*(one.observations for one in frames), strict=True)
        return self._problem(tuple(FrameObservations(frames=kind) for kind in together))

    def hypotheses(self, observations: Sequence[Observation]) -> Problem:
        """The poses of several hypotheses about one frame, the shape known. observations: of that frame."""
        return self._problem(tuple(observations))

    def _problem(self, observations: tuple[Observation, ...]) -> Problem:
        return Problem(
            space=self.motion.space,
            skeleton=self.kinematics.skeleton,
            shape=self.shape,
            observations=observations,
            priors=(
                ConstraintPrior(constraints=self._constraints, has_ties=False),
                PosturePrior(postures=self._postures),
            ),
        )

    @cached_property
    def _constraints(self) -> PoseConstraints:
        return PoseConstraints(self.kinematics.skeleton)

    @cached_property
    def _postures(self) -> PostureResiduals:
        prior = HandPrior(self.kinematics.skeleton, self.kinematics.shape_space).to(self.shape.device)
        return PostureResiduals.of(prior.postures)


def contour_settings(
    update: UnscentedUpdateSettings | ExtendedUpdateSettings | None, overconfidence: float = 1.0
) -> ContourSettings:
    """How much contours count in a fit beside a tracker, by the settings of its update rule.

    overconfidence: by which all frames have errors in common, such as those of the model's surface.
    """
    s = (update if isinstance(update, ExtendedUpdateSettings) else ExtendedUpdateSettings()).contour
    return replace(
        s, contour_weight=s.contour_weight / overconfidence, coverage_weight=s.coverage_weight / overconfidence
    )
