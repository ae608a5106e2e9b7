"""Registration of one frame from several hypotheses: the prediction, and proposals that the picture may bear out."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.fit import ConstraintPrior, PosturePrior, Problem, Schedule, Solutions, solve
from torchhand.fit.contour import ContourObservation, PictureContours, picture_contours, pixels_per_metre
from torchhand.hand import HandPose, PoseSpace
from torchhand.track.extended.proposals import finger_proposals, posture_proposals, turned_proposals
from torchhand.track.extended.settings import DistanceTrackerSettings
from torchhand.view import Contours, HandProjector

_ROOT = 6
_PROMISING = 6  # starts of a search that are followed up
_CONTOUR = "contour"


@dataclass(frozen=True, kw_only=True)
class FrameSearch:
    """What the registrations of one frame share."""

    settings: DistanceTrackerSettings
    space: PoseSpace
    """About the pose of the track's start."""
    contours: Contours
    projector: HandProjector
    priors: tuple[ConstraintPrior | PosturePrior, ...]
    image: UInt8[Tensor, "height width 3"]
    hand: HandPose
    """() in the camera's frame; of the frame before."""

    def picture(self, mask: Bool[Tensor, "height width"], schedule: Schedule) -> PictureContours:
        """The contours of a silhouette."""
        return picture_contours(mask, schedule, self.settings.contour, image=self.image)

    def best(self, picture: PictureContours, starts: HandPose, schedule: Schedule) -> Solutions:
        """The cheapest registration from some starts (starts)."""
        found = self._all(picture, starts, schedule)
        return found.select(found.best)

    def normalized_residual(self, found: Solutions) -> float:
        """Distance of the contours from each other over the largest that is good; infinite where nothing was found."""
        if not bool(found.cost.isfinite()):
            return math.inf
        apart_px = float(found.explained_by(_CONTOUR).distance)
        scale = float(pixels_per_metre(self.projector.camera, found.pose))
        return apart_px / scale / self.settings.max_contour_distance_m

    def reinitialized(
        self, found: Solutions, picture: PictureContours, foreground: Bool[Tensor, "height width"]
    ) -> tuple[Solutions, PictureContours]:
        """The better of a bad registration and of those from other places, directions, postures and fingers.

        foreground: where the picture has the hand's colours, wherever the hand was expected. The second result is the
        contours that the registration was made on.
        """
        s = self.settings
        if self.normalized_residual(found) > s.relocation_ratio:
            other = self._elsewhere(foreground)
            if other is not None and float(other.cost) < float(found.cost):
                found, picture = other, self.picture(foreground, s.schedule)
        if self.normalized_residual(found) > 1:
            start = self.space.constant
            proposals = (posture_proposals(found.pose, start, s.postures), finger_proposals(found.pose, start))
            found = _cheaper(found, self.best(picture, HandPose.cat(proposals), s.schedule))
        return found, picture

    def with_other_fingers(self, found: Solutions, picture: PictureContours, turn: int) -> Solutions:
        """A registration, or a cheaper one with another finger elsewhere: the outline may bear out both.

        The fingers take turns. A promising one has further to go than a prediction and is registered twice.
        """
        s, starts = self.settings, finger_proposals(found.pose, self.space.constant)
        count = min(s.finger_proposals, len(starts))
        if not count:
            return found
        due = torch.tensor([(turn * s.finger_proposals + i) % len(starts) for i in range(count)])
        other = self.best(picture, starts[due], s.schedule)
        if float(other.cost) < s.max_cost_ratio * float(found.cost):
            other = self.best(picture, other.pose.reshape(1), s.schedule)
        return _cheaper(found, other)

    def _elsewhere(self, foreground: Bool[Tensor, "height width"]) -> Solutions | None:
        """The best of many places and directions, with the fingers as they were and as at the start.

        All of them on the coarsest map, the most promising ones on the finer maps as well.
        """
        schedule = self.settings.search_schedule
        model = self.projector.silhouette(self.hand.dofs, self.hand.reference)
        turned = turned_proposals(self.hand, model, foreground, self.projector.camera)
        if turned is None:
            return None
        angles = self.space.constant[_ROOT:].expand(len(turned), -1)
        at_start = HandPose.of(torch.cat((turned.dofs[:, :_ROOT], angles), -1), turned.reference)
        coarse = picture_contours(foreground, schedule[:1], self.settings.contour)
        rough = self._all(coarse, HandPose.cat((turned, at_start)), schedule[:1])
        promising = rough.cost.argsort()[:_PROMISING]
        return self.best(self.picture(foreground, schedule), rough.pose[promising], schedule)

    def _all(self, picture: PictureContours, starts: HandPose, schedule: Schedule) -> Solutions:
        observation = ContourObservation(picture=picture, contours=self.contours, settings=self.settings.contour)
        problem = Problem(
            space=self.space,
            skeleton=self.projector.kinematics.skeleton,
            shape=self.contours.shape,
            observations=(observation,),
            priors=self.priors,
        )
        return solve(problem, starts, schedule)


def priors_of(
    space: PoseSpace, constraints: ConstraintPrior, postures: PosturePrior
) -> tuple[ConstraintPrior | PosturePrior, ...]:
    """The priors of a pose space; none where it does not move the joints at all."""
    return (constraints, postures) if bool(space.basis[_ROOT:].any()) else ()


def _cheaper(one: Solutions, other: Solutions) -> Solutions:
    return other if float(other.cost) < float(one.cost) else one
