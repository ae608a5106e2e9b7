"""One camera: the first hand, found as in a single picture, over all that may be skin."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from torchhand.fit.detect import ContourFitter, NoStart, start_at_pose
from torchhand.hand import HandPose
from torchhand.track.knowledge import TrackerState
from torchhand.track.proposals.keypoints import fitter_of
from torchhand.track.proposals.learned import FALSE_STARTS, has_wrist_in_picture
from torchhand.track.proposals.protocol import Occasion, Proposals, Proposed
from torchhand.track.scene import Candidate, Scene, View
from torchhand.track.single import SinglePoseFitter, SinglePoseSettings, hand_odds, learned_poses

_AT, _EVERY = 5, 10  # searches in vain to the first such, which takes seconds, and from one to the next
_MIN_OVERLAP = 0.75  # with the silhouette by the colours that the hand gives


@dataclass(frozen=True, kw_only=True)
class SinglePictureHands:
    """The hand of a single picture (`SinglePoseFitter`) where everything else has found none, every few frames.

    It looks at several pieces of what may be skin, in which the hand need not be the likeliest, and asks the network
    about each. The first hand brings its colours and its proportions.
    """

    occasion: ClassVar[Occasion] = "patient"
    fitter: ContourFitter
    """How the first hand is fitted; with a pinhole camera, which is the world."""

    @cached_property
    def _single(self) -> SinglePoseFitter:
        settings = SinglePoseSettings(alone_odds=hand_odds().reached[FALSE_STARTS])
        sources = (learned_poses(self.fitter.kinematics),)
        return SinglePoseFitter(self.fitter.kinematics, settings, sources=sources)

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand; none once one was found, nor where the user says what the hand is."""
        image, is_due = scene.views[0].image, state.is_search_due and state.searches_in_vain % _EVERY == _AT
        if image is None or scene.masks[0] is not None or best is not None or state.has_started or not is_due:
            return Proposals()
        known = None if self.fitter.fit_shape else self.fitter.shape
        found = self._single(View(image=image), self.fitter.camera, shape=known)
        if found.estimate.pose is None:
            return Proposals()
        pose = HandPose.of(found.estimate.pose.to(self.fitter.shape))
        if not bool(has_wrist_in_picture(self.fitter, pose)):
            return Proposals()
        start = start_at_pose(image, pose, fitter_of(pose, self.fitter))
        if isinstance(start, NoStart) or start.overlap < _MIN_OVERLAP:
            return Proposals()
        return Proposals(hands=(Proposed.of_start(start),), has_foreground=True)
