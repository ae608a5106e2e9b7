"""Registration of one scene from several hypotheses: the prediction, and others that the pictures may bear out."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import Observation, Problem, Schedule, Solutions, solve
from torchhand.fit.contour import ContourObservation, PictureContours, picture_contours
from torchhand.hand import HandPose, PoseSpace
from torchhand.track.extended.hypotheses import other_fingers, other_postures, turned_hands
from torchhand.track.extended.settings import ExtendedUpdateSettings
from torchhand.track.scene import Scene
from torchhand.view import Contours, HandProjector

_ROOT = 6
_PROMISING = 6  # starts of a search that are followed up
_AT_ONCE = 128

Pictures = tuple[PictureContours | None, ...]
"""Contours of the hand, view by view; None where a view shows nothing."""


@dataclass(frozen=True, kw_only=True)
class SceneRegistration:
    """What the registrations of one scene share."""

    settings: ExtendedUpdateSettings
    space: PoseSpace
    """About the pose of the track's start."""
    shape: Float[Tensor, "shape"]
    contours: tuple[Contours, ...]
    """Of the surface to fit, before each camera."""
    projectors: tuple[HandProjector, ...]
    keypoints: tuple[Observation, ...]
    """Detected keypoints, where there are any."""
    priors: tuple[Observation, ...]
    scene: Scene
    pose: HandPose
    """Of the frame before."""

    def pictures(self, masks: tuple[Bool[Tensor, "_height _width"] | None, ...], schedule: Schedule) -> Pictures:
        """Contours of the silhouettes, and the valleys within them, for a schedule."""
        return tuple(
            None if mask is None else picture_contours(mask, schedule, self.settings.contour, image=view.image)
            for mask, view in zip(masks, self.scene.views, strict=True)
        )

    def best(self, pictures: Pictures, starts: HandPose, schedule: Schedule) -> Solutions:
        """The cheapest registration from some starts."""
        found = self._all(pictures, starts, schedule)
        return found.select(found.best)

    def badness(self, found: Solutions) -> float:
        """Distance of the contours from each other over the one that is bad, in the worst view; infinite where nothing
        was found."""
        if not bool(found.cost.isfinite()):
            return float("inf")
        told = [one for one in found.explained if one.name == "contour" and bool(one.distance.isfinite().all())]
        metres = [float(one.distance[0]) / self._px_per_m(found.pose, one.view or 0) for one in told]
        return max(metres, default=float("inf")) / self.settings.bad_m

    def mended(
        self, found: Solutions, pictures: Pictures, foreground: tuple[Bool[Tensor, "_height _width"] | None, ...]
    ) -> tuple[Solutions, Pictures]:
        """The better of a bad registration and of those from other places, directions, postures and fingers.

        foreground: where the pictures have the hand's colours, wherever the hand was expected. The second result is the
        contours that the registration was made on.
        """
        s = self.settings
        if self.badness(found) > s.sudden and len(self.contours) == 1:
            other = self._elsewhere(foreground)
            if other is not None and float(other.cost) < float(found.cost):
                found, pictures = other, self.pictures(foreground, s.following)
        if self.badness(found) > 1:
            start, here = self.space.constant, found.pose
            dofs = torch.cat((other_postures(here.dofs, start, s.postures), other_fingers(here.dofs, start)))
            other = self.best(pictures, HandPose.of(dofs, here.reference), s.following)
            found = other if float(other.cost) < float(found.cost) else found
        return found, pictures

    def with_other_fingers(self, found: Solutions, pictures: Pictures, turn: int) -> Solutions:
        """A registration, or a cheaper one with another finger elsewhere: the outline may bear out both.

        The fingers take turns. A promising one has further to go than a prediction and is registered twice.
        """
        s, here = self.settings, found.pose
        starts = other_fingers(here.dofs, self.space.constant)
        count = min(s.finger_proposals, len(starts))
        due = [(turn * s.finger_proposals + i) % len(starts) for i in range(count)]
        if not due:
            return found
        other = self.best(pictures, HandPose.of(starts[due], here.reference), s.following)
        if float(other.cost) < s.promising * float(found.cost):
            other = self.best(pictures, HandPose.stack([other.pose]), s.following)
        return other if float(other.cost) < float(found.cost) else found

    def _elsewhere(self, foreground: tuple[Bool[Tensor, "_height _width"] | None, ...]) -> Solutions | None:
        """The best of many places and directions, with the fingers as they were and as at the start.

        All of them on the coarsest map, the most promising ones on the finer maps as well.
        """
        [mask], [projector], starting = foreground, self.projectors, self.settings.starting
        if mask is None:
            return None
        model = projector.silhouette(self.pose.dofs, self.pose.reference)
        starts = turned_hands(self.pose, model, mask, projector.camera)
        if starts is None:
            return None
        at_start = self.space.constant[_ROOT:].expand(len(starts), -1)
        at_start = replace(starts, dofs=torch.cat((starts.dofs[:, :_ROOT], at_start), -1))
        coarse = starting[:1]
        rough = self._all(
            (picture_contours(mask, coarse, self.settings.contour),), HandPose.cat([starts, at_start]), coarse
        )
        best = rough.cost.argsort()[:_PROMISING]
        return self.best(self.pictures(foreground, starting), rough.pose[best], starting)

    def _all(self, pictures: Pictures, starts: HandPose, schedule: Schedule) -> Solutions:
        contours = tuple(
            ContourObservation(picture=picture, contours=own, settings=self.settings.contour, view=view)
            for view, (picture, own) in enumerate(zip(pictures, self.contours, strict=True))
            if picture is not None
        )
        problem = Problem(
            space=self.space,
            skeleton=self.projectors[0].kinematics.skeleton,
            shape=self.shape,
            observations=(*contours, *self.keypoints),
            priors=self.priors,
        )
        return solve(problem, starts, schedule, at_once=_AT_ONCE)

    def _px_per_m(self, pose: HandPose, view: int) -> float:
        camera = self.projectors[view].camera
        focal = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
        if camera.kind == "orthographic":
            return focal
        return focal / max(float(camera.cam_from_world(pose.dofs[:3])[2]), 1e-3)
