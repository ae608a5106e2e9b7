"""The second pass over a recording: the hand of the first one, followed from the last frame to the first."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.keypoints import PostureKeypoints
from torchhand.hand import HandPose
from torchhand.numerics import single_threaded
from torchhand.track.belief import FollowedHand
from torchhand.track.knowledge import Estimate, TrackerState
from torchhand.track.scene import (
    Scene,
    SceneKeypoints,
    SilhouetteComparison,
    View,
    learned_observations,
    seen_posture,
)
from torchhand.track.shape import reshaped_poses
from torchhand.track.tracker import Tracker

_NATS = 40.0
"""Nats between two hands of one frame, of which one is borne out wholly and the other not at all, in the posture that
the network sees and in detected keypoints. By a logistic regression of which hand is nearer to the truth where the two
passes lead to different ones (`rom_back`, `rom_side`, `rom_palm`, `free`, `flexion`, `jump`, with and without
keypoints: 20 to 90). Half as much changes no flexion error there by more than 0.3°."""
_OVERLAP_NATS = 80.0
"""The same in the overlap with the silhouettes (there 0 to 50; it decides where the network is misled)."""
_SAME_M = 0.003  # mean distance of keypoints, up to which two hands are taken for one: no pass is better
_NEAR_M = 0.01  # mean distance of keypoints, up to which a view of one hand shows another as well
_HELD = 1e-6  # radians and metres by which a pose may differ from what a track can reach


@dataclass(frozen=True, kw_only=True)
class SecondEstimate:
    """One frame of the second pass."""

    estimate: Estimate
    evidence: float | None = None
    """How far the views bear out the hand, nats; None where nothing is compared."""
    evidence_before: float | None = None
    """The same of the hand of the first pass, in the same scene."""


class BackwardPass:
    """Follows a hand through the frames of a recording in reverse order.

    The tracker steps as it does forwards, with keypoints, network and proposals, and time runs backwards. Where it has
    no hand it takes that of the first pass; where that has none either, nothing is looked for: the first pass did.
    """

    def __init__(self, tracker: Tracker, state: TrackerState, *, shape: Float[Tensor, "shape"] | None = None) -> None:
        """state: of the tracker after the last frame of the first pass. shape: proportions of the hand that is followed
        back, where they are not those of the first pass. Raises ValueError where the state knows no proportions, which
        is where no hand was ever found."""
        if state.shape is None:
            raise ValueError("state: expected one of a tracker that has found a hand")
        self._tracker, self._shape_before, self._last = tracker, state.shape, state.hand
        self._shape = state.shape if shape is None else shape
        mirrored = tuple(replace(one, time_s=-one.time_s) for one in state.keyframes)
        self._state = replace(state, time_s=None, hand=None, keyframes=mirrored, shape=self._shape)
        self._comparisons = [
            SilhouetteComparison(tracker.kinematics, tracker.parts.cameras, one, side_px=tracker.settings.check_side_px)
            for one in (self._shape, self._shape_before)
        ]

    def step(self, views: Sequence[View], time_s: float, pose: Float[Tensor, "36"] | None) -> SecondEstimate:
        """The frame before that of the last call. pose: of the first pass, with the root's whole rotation vector; None
        where it found no hand."""
        device = self._tracker.device
        before = None if pose is None else HandPose.of(pose.to(device)).normalized()
        if self._state.hand is None:
            if before is None:
                return SecondEstimate(estimate=Estimate(status="no_hand", time_s=time_s, reason="nothing to follow"))
            self._state = replace(self._state, hand=self._begun(self._reshaped(before)), time_s=None)
        self._state, estimate = self._tracker.step(self._state, views, -time_s)
        estimate = replace(estimate, time_s=time_s)
        if estimate.keypoints is None or estimate.pose is None or before is None:
            return SecondEstimate(estimate=estimate)
        keypoints = estimate.keypoints.to(device)
        if float((keypoints - self._keypoints(before, self._shape_before)).norm(dim=-1).mean()) < _SAME_M:
            return SecondEstimate(estimate=estimate, evidence=0.0, evidence_before=0.0)
        scene = self._tracker.scene(self._state, views, -time_s)
        here, there = self._evidence([HandPose.of(estimate.pose.to(device)).normalized(), before], scene)
        return SecondEstimate(estimate=estimate, evidence=here, evidence_before=there)

    def _reshaped(self, before: HandPose) -> HandPose:
        """A pose of the first pass as one of the hand that is followed back."""
        if self._shape is self._shape_before:
            return before
        parts = self._tracker.parts
        moved = reshaped_poses(before.vector[None], parts.motion, parts.kinematics, self._shape_before, self._shape)
        return HandPose.of(moved[0]).normalized()

    def _keypoints(self, pose: HandPose, shape: Float[Tensor, "shape"]) -> Float[Tensor, "21 3"]:
        return self._tracker.kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints

    @torch.inference_mode()
    def _begun(self, pose: HandPose) -> FollowedHand:
        """A hand at a pose, with the base of the last track where that can reach the pose."""
        motion, last = self._tracker.parts.motion, self._last
        if last is None:
            return motion.started(pose)
        like = motion.started(pose, last.base)
        is_reached = bool(((motion.pose(like).normalized().vector - pose.vector).abs() < _HELD).all())
        return replace(like if is_reached else motion.started(pose), start_reference=last.start_reference)

    @torch.inference_mode()
    @single_threaded()
    def _evidence(self, poses: Sequence[HandPose], scene: Scene) -> list[float]:
        """Of two hands in one scene, that of this pass and that of the first one with its own proportions, both judged
        by what the network sees where either is."""
        parts, shapes = self._tracker.parts, (self._shape, self._shape_before)
        learned = SceneKeypoints(pictures=(), postures=tuple(self._postures(poses, scene)))
        told = (parts.keypoints(scene), learned)
        found = []
        for pose, shape, comparison in zip(poses, shapes, self._comparisons, strict=True):
            shares = [one.agreement(pose, shape) for one in told]
            told_nats = _NATS * sum(share for share in shares if share is not None)
            found.append(_OVERLAP_NATS * comparison(pose, scene).overlap + told_nats)
        return found

    def _postures(self, poses: Sequence[HandPose], scene: Scene) -> Iterator[PostureKeypoints]:
        """What the network sees where each of some hands is; those near the first one are seen in the same view."""
        parts = self._tracker.parts
        if not parts.has_learned_posture:
            return
        points = [self._keypoints(*one) for one in zip(poses, (self._shape, self._shape_before), strict=True)]
        apart = [float((own - points[0]).norm(dim=-1).mean()) for own in points]
        for pose in (one for one, off in zip(poses, apart, strict=True) if off == 0.0 or off > _NEAR_M):
            seen = seen_posture(scene, parts.cameras[0], parts.kinematics, pose, self._shape)
            told = () if seen is None else learned_observations(seen, pose)
            yield from (one for one in told if isinstance(one, PostureKeypoints))
