"""The hand that detected keypoints tell of, whatever was followed: one camera or several."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from torch import Tensor

from torchhand.fit import Appearance
from torchhand.fit.detect import (
    ContourFitter,
    NoStart,
    Start,
    are_colours_shared,
    cut_at_keypoints,
    start_at_cut,
    start_at_pose,
)
from torchhand.fit.keypoints import KeypointSettings
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics, HandPose
from torchhand.track.knowledge import TrackerState
from torchhand.track.proposals.protocol import Occasion, Proposals, Proposed
from torchhand.track.scene import Candidate, Scene, detected_hand

_SLANT = 0.6  # radians between bones and the picture's plane up to which an outline tells their length: cos is 0.83
_TOLD_BY_COLOURS = 0.92  # overlap with what has the hand's colours at which nothing else is tried
_SHARED_COLOURS = 0.08
"""By how much the overlap of a hand with what is cut out about its points is larger than with its colours where others
share these: 0.08 to 0.46 in most pictures before a clutter with skin's."""
_FLEXIONS = [i for i, name in enumerate(DOFS) if name.endswith(("mcp_fe", "pip_fe", "dip_fe"))]


@dataclass(frozen=True, kw_only=True)
class KeypointHand:
    """A hand in the posture and place of the points."""

    occasion: ClassVar[Occasion] = "detected"
    kinematics: HandKinematics
    cameras: Sequence[Camera]
    """Cameras of the scene, one per view."""
    settings: KeypointSettings

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand; none of one camera before the first, which has to bring its colours."""
        if len(self.cameras) == 1 and not state.has_started:
            return Proposals()
        shape = self.kinematics.default_shape if state.shape is None else state.shape
        pose = detected_hand(scene, self.cameras, self.kinematics, self.settings, shape)
        if pose is None:
            return Proposals()
        new_shape = shape if state.shape is None else None
        return Proposals(hands=(Proposed(pose=pose, shape=new_shape),), has_foreground=True)


@dataclass(frozen=True, kw_only=True)
class KeypointStart:
    """One camera: the first hand, where the points are, with its colours, and its proportions where these are not
    known. A hand that its colours do not tell from its surroundings is cut out about the points in every picture."""

    occasion: ClassVar[Occasion] = "degraded"
    fitter: ContourFitter
    """How that hand is fitted."""
    settings: KeypointSettings
    min_overlap: float
    """Intersection over union with what has its colours, below which any better cut is believed; 0 to 1."""

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand; once there was one, only where its colours turn out to be shared, and a search is due."""
        image = scene.views[0].image
        if image is None:
            return Proposals()
        own = self.fitter
        if state.has_started:
            return self._cut_anew(image, scene, state)
        pose = detected_hand(scene, (own.camera,), own.kinematics, self.settings, own.shape)
        if pose is None:
            return Proposals()
        start = self._start(image, scene, pose)
        if isinstance(start, NoStart):
            return Proposals(reason=start.reason, has_foreground=start.has_foreground)
        return Proposals(hands=(Proposed.of_start(start),), has_foreground=True)

    def _cut_anew(self, image: Tensor, scene: Scene, state: TrackerState) -> Proposals:
        """A hand that was followed by its colours, cut out about the points."""
        probability, keypoints, shape = scene.probabilities[0], scene.views[0].keypoints, state.shape
        by_colours = isinstance(state.appearance[0], Appearance) if state.appearance else False
        if not (state.is_search_due and by_colours) or probability is None or keypoints is None or shape is None:
            return Proposals()
        mask = cut_at_keypoints(image, keypoints.points_px)
        if mask is None or not are_colours_shared(probability, mask, keypoints.points_px):
            return Proposals()
        own = replace(self.fitter, shape=shape, fit_shape=False)
        pose = detected_hand(scene, (own.camera,), own.kinematics, self.settings, shape)
        if pose is None:
            return Proposals()
        start = start_at_cut(mask, pose, own)
        fitted = HandPose.of(start.fit.pose, start.fit.root_reference)
        return Proposals(hands=(Proposed(pose=fitted, appearance=start.appearance),), has_foreground=True)

    def _start(self, image: Tensor, scene: Scene, pose: HandPose) -> Start | NoStart:
        """By colours, learned at the hand as the points place it or as a graph cut about these does; by such cuts where
        they tell it so much better that the colours must be those of other things too."""
        own, keypoints = fitter_of(pose, self.fitter), scene.views[0].keypoints
        by_colours = start_at_pose(image, pose, own)
        if keypoints is None or _overlap(by_colours) >= _TOLD_BY_COLOURS:
            return by_colours
        mask = cut_at_keypoints(image, keypoints.points_px)
        if mask is None:
            return by_colours
        by_points = start_at_cut(mask, pose, own)
        placed = HandPose.of(by_points.fit.pose, by_points.fit.root_reference)
        by_colours = max(by_colours, start_at_pose(image, placed, own), key=_overlap)
        if isinstance(by_colours, NoStart) or by_colours.overlap < self.min_overlap:
            return max(by_colours, by_points, key=_overlap)
        if by_points.overlap <= by_colours.overlap + _SHARED_COLOURS:
            return by_colours
        colours = by_colours.appearance
        assert isinstance(colours, Appearance)
        is_shared = are_colours_shared(colours.probability(image), mask, keypoints.points_px)
        return by_points if is_shared else by_colours


def _overlap(start: Start | NoStart) -> float:
    """0 where there is none."""
    return start.overlap if isinstance(start, Start) else 0.0


def fitter_of(pose: HandPose, fitter: ContourFitter) -> ContourFitter:
    """The fitter of a first hand that is placed: proportions are fitted where they are not known and it shows them."""
    return replace(fitter, fit_shape=fitter.fit_shape and _shows_proportions(pose, fitter.camera))


def _shows_proportions(pose: HandPose, camera: Camera) -> bool:
    """Whether the outline of a hand tells its proportions: an open hand, parallel to the picture."""
    palm = float((camera.rotation.to(pose.rotation) @ pose.rotation)[2, 0].abs())
    return palm > math.cos(_SLANT) and float(pose.dofs[_FLEXIONS].max()) < _SLANT
