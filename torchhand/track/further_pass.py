"""A further pass over a recording: the hand of the one before, followed from the last frame to the first, or once more
from the first to the last."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.keypoints import PostureKeypoints
from torchhand.geometry import cosine_between
from torchhand.hand import HandPose
from torchhand.numerics import single_threaded
from torchhand.track.alternatives import SAME_M, Alternatives, TiltAlternatives, misplaced_nats
from torchhand.track.belief import FollowedHand
from torchhand.track.knowledge import Estimate, TrackerState
from torchhand.track.paths import MOTION_NATS
from torchhand.track.proportions import FittedShape, reshaped_poses
from torchhand.track.scene import (
    Scene,
    SceneKeypoints,
    SilhouetteComparison,
    View,
    learned_observations,
    seen_posture,
)
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
_LOOK_EVERY = 5  # frames from one look at other tilts to the next
_SLID = 0.1  # overlap that a likelier hand must not lose where the tracker places it: it was another one then
_TURNED = 0.05  # overlap that one which faces away must gain
_HELD = 1e-6  # radians and metres by which a pose may differ from what a track can reach


@dataclass(frozen=True, kw_only=True)
class SecondEstimate:
    """One frame of a further pass."""

    estimate: Estimate
    evidence: float | None = None
    """How far the views bear out the hand, nats; None where nothing is compared."""
    evidence_before: float | None = None
    """The same of the hand of the pass before, in the same scene."""
    alternatives: Alternatives | None = None
    """Hands that explain the picture, where others were looked for."""


class FurtherPass:
    """Follows a hand through the frames of a recording in reverse order; or, after such a pass, in their order again.

    The tracker steps as it does forwards, with keypoints, network and proposals, and time runs backwards. Where it has
    no hand it takes that of the pass before; where that has none either, nothing is looked for: the first pass did.
    """

    def __init__(
        self, tracker: Tracker, state: TrackerState, *, fitted: FittedShape | None = None, is_backward: bool = True
    ) -> None:
        """state: of the tracker after the last frame of the first pass. fitted: proportions of the hand that is
        followed, where they are not those of the first pass. is_backward: whether frames come from the last one on, as
        those of a second pass do; else in their order. Raises ValueError where the state knows no proportions, which is
        where no hand was ever found."""
        if state.shape is None:
            raise ValueError("state: expected one of a tracker that has found a hand")
        self._tracker = tracker = tracker.at(state)
        self._shape_before, self._last = state.shape, state.hand
        self._shape = state.shape if fitted is None else fitted.shape
        if fitted is not None:
            state = replace(state, shape=fitted.shape, shape_keypoints_cov=fitted.keypoints_cov)
        self._sign = -1.0 if is_backward else 1.0
        mirrored = tuple(replace(one, time_s=self._sign * one.time_s) for one in state.keyframes)
        self._state = replace(state, time_s=None, hand=None, last_seen=None, keyframes=mirrored)
        self._tilts = TiltAlternatives(tracker, self._state) if TiltAlternatives.can_tilt(tracker) else None
        self._frames_to_look = 0
        self._odds: tuple[Tensor, Tensor] | None = None
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
        self._state, estimate = self._tracker.step(self._state, views, self._sign * time_s)
        estimate = replace(estimate, time_s=time_s)
        other, estimate = self._other_tilts(estimate, before, views, time_s)
        if estimate.keypoints is None or estimate.pose is None or before is None:
            return SecondEstimate(estimate=estimate, alternatives=other)
        keypoints = estimate.keypoints.to(device)
        if float((keypoints - self._keypoints(before, self._shape_before)).norm(dim=-1).mean()) < _SAME_M:
            return SecondEstimate(estimate=estimate, evidence=0.0, evidence_before=0.0, alternatives=other)
        scene = self._tracker.scene(self._state, views, self._sign * time_s)
        here, there = self._evidence([HandPose.of(estimate.pose.to(device)).normalized(), before], scene)
        return SecondEstimate(estimate=estimate, evidence=here, evidence_before=there, alternatives=other)

    def _other_tilts(
        self, estimate: Estimate, before: HandPose | None, views: Sequence[View], time_s: float
    ) -> tuple[Alternatives | None, Estimate]:
        """Every few frames, the hands that explain the picture; the likeliest is followed on where it is surely
        likelier."""
        self._frames_to_look -= 1
        if self._tilts is None or estimate.pose is None or self._frames_to_look > 0:
            return None, estimate
        self._frames_to_look = _LOOK_EVERY
        device = self._tracker.device
        scene = self._tracker.scene(self._state, views, self._sign * time_s)
        hands = [HandPose.of(estimate.pose.to(device)).normalized()]
        hands += [] if before is None else [self._reshaped(before)]
        found = self._tilts(scene, hands)
        if found is None:
            self._odds = None
            return None, estimate
        assert estimate.keypoints is not None
        away = found.keypoints - estimate.keypoints.to(device)
        odds = self._odds_of(found, away)
        best = int(odds.argmax())
        if float((away[best] - away[best].mean(0)).norm(dim=-1).mean()) > SAME_M:
            placed = self._tracker.placed(self._state, found.pose[best], scene)
            if placed is not None and is_borne_out(estimate, placed[1], is_firm=self._state.began_open):
                self._state, other = placed
                assert other.keypoints is not None
                away = away - (other.keypoints - estimate.keypoints).to(device)
                estimate = replace(other, time_s=time_s)
                found = replace(found, row=(best, *found.row[1:]))
        self._odds = (away, odds)
        return found, estimate

    def _odds_of(self, found: Alternatives, away: Tensor) -> Tensor:
        """Logarithms of how likely each hand is by all looks so far: from one look to the next the hand seldom moves in
        relation to the one that is followed (forward algorithm, Rabiner 1989). away: (k 21 3)"""
        if self._odds is None:
            return -found.cost
        before, odds = self._odds
        moved = (away[:, None] - before).norm(dim=-1).mean(-1)
        return -found.cost + (odds - MOTION_NATS * moved).logsumexp(1)

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
            overlap_nats = _OVERLAP_NATS * comparison(pose, scene).overlap
            found.append(
                overlap_nats + told_nats - float(misplaced_nats(self._tracker, scene, HandPose.stack([pose]), shape))
            )
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


def is_borne_out(followed: Estimate, other: Estimate, *, is_firm: bool) -> bool:
    """Whether a likelier hand takes the place of a followed one as the tracker places it: with less overlap it is
    another hand then. One that faces away, such as that of the other pass may, must gain some where the side of the
    followed one is firm (`Health.better`)."""
    if followed.pose is None or other.pose is None:
        return False
    turned = cosine_between(HandPose.of(followed.pose).rotation, HandPose.of(other.pose).rotation)
    least = _TURNED if is_firm and float(turned) < 0 else -_SLID
    return (other.overlap or 0.0) > (followed.overlap or 0.0) + least
