"""Registration of one frame from several hypotheses: the prediction, and others that the picture may bear out."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.fit import PostureResiduals
from torchhand.fit.contour import (
    PictureContours,
    Registration,
    RegistrationSettings,
    hand_length_px,
    picture_contours,
    register,
)
from torchhand.hand import PoseConstraints, PoseSpace
from torchhand.track.extended.settings import DistanceTrackerSettings
from torchhand.track.extended.sudden import other_fingers, other_postures, turned_hands
from torchhand.view import Contours, HandProjector

_ROOT = 6
_PROMISING = 6  # starts of a search that are followed up


@dataclass(frozen=True, kw_only=True)
class FrameSearch:
    """What the registrations of one frame share."""

    settings: DistanceTrackerSettings
    space: PoseSpace
    """About the pose of the track's start."""
    contours: Contours
    projector: HandProjector
    constraints: PoseConstraints
    prior: PostureResiduals
    image: UInt8[Tensor, "height width 3"]
    pose: Float[Tensor, "36"]
    """Of the frame before."""
    reference: Float[Tensor, "3 3"]
    """cam_from_hand of the frame before."""

    def best(
        self,
        picture: PictureContours,
        poses: Float[Tensor, "starts 36"],
        settings: RegistrationSettings,
        references: Float[Tensor, "#starts 3 3"] | None = None,
    ) -> Registration:
        """The cheapest registration from some starts, about the last frame's reference where no others are given."""
        found = self._all(picture, poses, settings, references)
        return found.select(found.best)

    def badness(self, found: Registration) -> float:
        """Distance of the contours from each other over the one that is bad; infinite where nothing was found."""
        camera, shape = self.projector.camera, self.projector.shape
        length_px = hand_length_px(camera, self.projector.kinematics, found.pose, shape)
        share = float(found.contour_px) / length_px / self.settings.bad_share
        return share if math.isfinite(share) else math.inf

    def mended(
        self, found: Registration, picture: PictureContours, foreground: Bool[Tensor, "height width"]
    ) -> tuple[Registration, PictureContours]:
        """The better of a bad registration and of those from other places, directions, postures and fingers.

        foreground: where the picture has the hand's colours, wherever the hand was expected. The second result is the
        contours that the registration was made on.
        """
        s = self.settings
        if self.badness(found) > s.sudden:
            other = self._elsewhere(foreground)
            if other is not None and float(other.cost) < float(found.cost):
                found, picture = other, picture_contours(foreground, s.registration, image=self.image)
        if self.badness(found) > 1:
            start = self.space.constant
            poses = (other_postures(found.pose, start, s.postures), other_fingers(found.pose, start))
            other = self.best(picture, torch.cat(poses), s.registration, found.root_reference[None])
            found = other if float(other.cost) < float(found.cost) else found
        return found, picture

    def reconsidered(self, found: Registration, picture: PictureContours, turn: int) -> Registration:
        """A registration, or a cheaper one with another finger elsewhere: the outline may bear out both.

        The fingers take turns. A promising one has further to go than a prediction and is registered twice.
        """
        s, starts = self.settings, other_fingers(found.pose, self.space.constant)
        due = [(turn * s.reconsidered + i) % len(starts) for i in range(min(s.reconsidered, len(starts)))]
        if not due:
            return found
        other = self.best(picture, starts[due], s.registration, found.root_reference[None])
        if float(other.cost) < s.promising * float(found.cost):
            other = self.best(picture, other.pose[None], s.registration, other.root_reference[None])
        return other if float(other.cost) < float(found.cost) else found

    def _elsewhere(self, foreground: Tensor) -> Registration | None:
        """The best of many places and directions, with the fingers as they were and as at the start.

        All of them on the coarsest map, the most promising ones on the finer maps as well.
        """
        search = self.settings.search
        model = self.projector.silhouette(self.pose, self.reference)
        starts = turned_hands(self.pose, self.reference, model, foreground, self.projector.camera)
        if starts is None:
            return None
        coarse = replace(search, levels=search.levels[:1])
        at_start = torch.cat((starts.pose[:, :_ROOT], self.space.constant[_ROOT:].expand(len(starts.pose), -1)), -1)
        poses, references = torch.cat((starts.pose, at_start)), starts.root_reference.repeat(2, 1, 1)
        rough = self._all(picture_contours(foreground, coarse), poses, coarse, references)
        best = rough.cost.argsort()[:_PROMISING]
        picture = picture_contours(foreground, search, image=self.image)
        return self.best(picture, rough.pose[best], search, rough.root_reference[best])

    def _all(
        self,
        picture: PictureContours,
        poses: Tensor,
        settings: RegistrationSettings,
        references: Tensor | None,
    ) -> Registration:
        return register(
            picture,
            self.contours,
            self.space,
            poses,
            self.reference[None] if references is None else references,
            settings,
            constraints=self.constraints,
            prior=self.prior,
        )
