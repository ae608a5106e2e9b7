"""Registration of one scene from several hypotheses: the prediction, and others that the pictures may bear out."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import Observation, Problem, Schedule, Solutions, Stage, solve
from torchhand.fit.contour import (
    CONTOUR,
    WHOLE_SEARCH,
    ContourObservation,
    PictureContours,
    picture_contours,
    pixels_per_metre,
)
from torchhand.hand import HandPose, PoseSpace
from torchhand.track.extended.proposals import finger_proposals, posture_proposals, turned_proposals
from torchhand.track.extended.settings import ExtendedUpdateSettings
from torchhand.track.scene import Scene
from torchhand.view import Contours, HandProjector

_ROOT = 6
_POSTURES = ("flat", "fist", "point")  # that are tried beside that of the start where registration is bad
_PROMISING = 6  # starts of a search that are followed up
_GOOD_M = 0.0015  # metres at the hand: largest mean distance of the contours from each other with which a hand is good
_ELSEWHERE = 2.0  # that distance, over the largest good one, beyond which the hand is sought elsewhere and turned
_MAX_COST_RATIO = 1.5  # cost of a hand with another finger, over that of the registered one, to be followed up

SCHEDULE = (Stage(gross_m=0.01125, rounds=1, iterations=3, pitch_px=2), Stage(gross_m=0.0075, rounds=1, iterations=4))
"""Registration of a scene from its prediction; the last stage is as wide as that of WHOLE_SEARCH, by which a hand is
registered that was found or is sought anew."""

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
    """Contours of the surface to fit, before each camera."""
    projectors: tuple[HandProjector, ...]
    keypoints: tuple[Observation, ...]
    """Detected keypoints, where there are any."""
    priors: tuple[Observation, ...]
    scene: Scene
    pose: HandPose
    """Pose in the frame before."""

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

    def normalized_residual(self, found: Solutions) -> float:
        """Distance of the contours from each other over the largest that is good, in the worst view; infinite where
        nothing was found."""
        if not bool(found.cost.isfinite()):
            return math.inf
        contours = [one for one in found.explained if one.name == CONTOUR and bool(one.distance.isfinite().all())]
        cameras = [self.projectors[one.view or 0].camera for one in contours]
        pairs = zip(contours, cameras, strict=True)
        metres = [float(one.distance) / float(pixels_per_metre(camera, found.pose)) for one, camera in pairs]
        return max(metres, default=math.inf) / _GOOD_M

    def reinitialized(
        self, found: Solutions, pictures: Pictures, foreground: tuple[Bool[Tensor, "_height _width"] | None, ...]
    ) -> tuple[Solutions, Pictures]:
        """The better of a bad registration and of those from other places, directions, postures and fingers.

        foreground: where the pictures have the hand's colours, wherever the hand was expected. The second result is the
        contours that the registration was made on.
        """
        if self.normalized_residual(found) > _ELSEWHERE and len(self.contours) == 1:
            other = self._elsewhere(foreground)
            if other is not None and float(other.cost) < float(found.cost):
                found, pictures = other, self.pictures(foreground, SCHEDULE)
        if self.normalized_residual(found) > 1:
            start = self.space.constant
            proposals = (posture_proposals(found.pose, start, _POSTURES), finger_proposals(found.pose, start))
            found = _cheaper(found, self.best(pictures, HandPose.cat(proposals), SCHEDULE))
        return found, pictures

    def with_other_fingers(self, found: Solutions, pictures: Pictures, turn: int) -> Solutions:
        """A registration, or a cheaper one with another finger elsewhere: the outline may bear out both.

        The fingers take turns. A promising one has further to go than a prediction and is registered twice.
        """
        s, starts = self.settings, finger_proposals(found.pose, self.space.constant)
        count = min(s.finger_proposals, len(starts))
        if not count:
            return found
        due = torch.tensor([(turn * s.finger_proposals + i) % len(starts) for i in range(count)])
        other = self.best(pictures, starts[due], SCHEDULE)
        if float(other.cost) < _MAX_COST_RATIO * float(found.cost):
            other = self.best(pictures, other.pose.reshape(1), SCHEDULE)
        return _cheaper(found, other)

    def _elsewhere(self, foreground: tuple[Bool[Tensor, "_height _width"] | None, ...]) -> Solutions | None:
        """The best of many places and directions, with the fingers as they were and as at the start.

        All of them on the coarsest map, the most promising ones on the finer maps as well.
        """
        [mask], [projector], schedule = foreground, self.projectors, WHOLE_SEARCH
        if mask is None:
            return None
        model = projector.silhouette(self.pose.dofs, self.pose.reference)
        turned = turned_proposals(self.pose, model, mask, projector.camera)
        if turned is None:
            return None
        angles = self.space.constant[_ROOT:].expand(len(turned), -1)
        at_start = HandPose.of(torch.cat((turned.dofs[:, :_ROOT], angles), -1), turned.reference)
        coarse = picture_contours(mask, schedule[:1], self.settings.contour)
        rough = self._all((coarse,), HandPose.cat((turned, at_start)), schedule[:1])
        promising = rough.cost.argsort()[:_PROMISING]
        return self.best(self.pictures(foreground, schedule), rough.pose[promising], schedule)

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
            observations=(*contours, *self.keypoints, *self.scene.observations),
            priors=self.priors,
        )
        return solve(problem, starts, schedule)


def _cheaper(one: Solutions, other: Solutions) -> Solutions:
    return other if float(other.cost) < float(one.cost) else one
