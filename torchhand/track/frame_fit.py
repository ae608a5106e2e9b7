"""What one camera tells of a hand in single frames of a recording, as observations of a fit.

Contours, detected keypoints, and the posture that a network sees.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from jaxtyping import Float
from torch import Tensor

from torchhand.devices import sent_to
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
from torchhand.hand import HandPose, HandPrior, PoseConstraints
from torchhand.image import clean, fill_holes, touching
from torchhand.track.extended import ExtendedUpdateSettings
from torchhand.track.knowledge import TrackerState
from torchhand.track.scene import Scene, View, learned_observations, scene_keypoints, seen_posture
from torchhand.track.tracker import Tracker
from torchhand.view import HandProjector, PrimitiveContours, outline_table

_HOLE_PX = 50  # largest hole of a silhouette that is filled, square px


@dataclass(frozen=True, kw_only=True)
class FollowedFrame:
    """A frame in which a hand was followed."""

    views: tuple[View, ...]
    time_s: float
    pose: Float[Tensor, "36"]
    """With the root's whole rotation vector, in the tracker's world."""


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

    tracker: Tracker
    state: TrackerState
    """Of the tracker, with the proportions and the hand's colours."""
    schedule: Schedule
    """Stages of the fit."""
    contours: ContourSettings

    def seen(self, frame: FollowedFrame) -> SeenFrame | None:
        """The observations of a frame; None where nothing of the hand's contour is seen."""
        scene = self.tracker.scene(self.state, frame.views, frame.time_s)
        return self.seen_in(scene, HandPose.of(frame.pose.to(self.tracker.device)).normalized())

    def seen_in(self, scene: Scene, pose: HandPose) -> SeenFrame | None:
        """The observations of a scene about the hand near a pose () with a zero rotation vector; None where nothing of
        its contour is seen."""
        parts, shape = self.tracker.parts, self.state.shape
        assert shape is not None
        outline = self.contour(scene, pose)
        if outline is None:
            return None
        found: list[Observation] = [outline]
        if parts.has_learned_posture:
            seen = seen_posture(scene, parts.cameras[0], parts.kinematics, pose, shape)
            found += () if seen is None else learned_observations(seen, pose)
        found += scene_keypoints(scene, parts.cameras, parts.kinematics, parts.keypoint_settings).observations
        return SeenFrame(pose=pose, observations=tuple(found))

    def contour(self, scene: Scene, pose: HandPose) -> ContourObservation | None:
        """The contour of the silhouette that a hand touches."""
        plane, kinematics, camera = scene.plane(0), self.tracker.parts.kinematics, self.tracker.parts.cameras[0]
        shape = self.state.shape
        assert shape is not None
        if plane is None:
            return None
        s, settings = self.tracker.settings, self.contours
        projector = HandProjector(kinematics, camera, shape)
        mask = fill_holes(touching(clean(plane > 0.5), projector.silhouette(pose.dofs, pose.reference)), _HOLE_PX)
        picture = picture_contours(mask, self.schedule, settings, image=scene.views[0].image)
        if picture.is_empty:
            return None
        table = sent_to(
            outline_table(s.points_per_generator, s.points_per_arc, without=("palm_wrist",)), self.tracker.device
        )
        return ContourObservation(picture=picture, contours=PrimitiveContours(projector, table), settings=settings)

    def problem(self, frames: Sequence[SeenFrame]) -> Problem:
        """The poses of some frames as one problem, the shape known."""
        together = zip(*(one.observations for one in frames), strict=True)
        return self._problem(tuple(FrameObservations(frames=kind) for kind in together))

    def hypotheses(self, observations: Sequence[Observation]) -> Problem:
        """The poses of several hypotheses about one frame, the shape known. observations: of that frame."""
        return self._problem(tuple(observations))

    def _problem(self, observations: tuple[Observation, ...]) -> Problem:
        kinematics, shape = self.tracker.parts.kinematics, self.state.shape
        assert shape is not None
        return Problem(
            space=self.tracker.parts.motion.space,
            skeleton=kinematics.skeleton,
            shape=shape,
            observations=observations,
            priors=(
                ConstraintPrior(constraints=PoseConstraints(kinematics.skeleton), has_ties=False),
                PosturePrior(postures=self._postures),
            ),
        )

    @cached_property
    def _postures(self) -> PostureResiduals:
        kinematics = self.tracker.parts.kinematics
        prior = HandPrior(kinematics.skeleton, kinematics.shape_space).to(self.tracker.device)
        return PostureResiduals.of(prior.postures)


def contour_settings(tracker: Tracker, overconfidence: float = 1.0) -> ContourSettings:
    """How much contours count in a fit beside a tracker.

    overconfidence: by which all frames have errors in common, such as those of the model's surface.
    """
    update = tracker.settings.update
    s = (update if isinstance(update, ExtendedUpdateSettings) else ExtendedUpdateSettings()).contour
    return replace(
        s, contour_weight=s.contour_weight / overconfidence, coverage_weight=s.coverage_weight / overconfidence
    )
