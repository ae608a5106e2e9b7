"""Backward smoothing: a hand that was found anew, or leapt, is followed back into the frames before; a hand that left
its path for one frame is looked for on it.

After a fast turn a tracker may hold a hand that explains the silhouettes well enough, until a better one is found. The
frames before are then estimated again: up to one of them the hand stays as it was followed, and from there on it is the
one that was found, followed backwards. That frame is where the silhouettes of all are explained best for the least
motion (the most probable path of two: Viterbi 1967).

A finger that moves fast may also be left behind for a frame, or be mistaken for another in one. The hand of that frame
is then also begun between those of the frames beside it, and stands there where that explains more for the motion.
"""

import itertools
import math
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import HandPose
from torchhand.track.knowledge import Estimate, TrackerState
from torchhand.track.multiview import HULL, Hull
from torchhand.track.scene import PackedMask, Scene, View
from torchhand.track.tracker import FollowedInto, Tracker

_MOTION = 3.0  # score that a metre of motion is worth, in the mean over the keypoints
_HOPELESS = 0.1  # gain less than with fewer frames, from which on no more are estimated again
_IN_VAIN = 8  # frames estimated again after those that explained most, from which on no more are
_LEAP = 0.015  # metres from one frame to the next, in the mean over the keypoints, that few hands move
_CLOCK_S = 1e-6  # times are compared to this
_SAME = 0.002  # metres between two hands that are one
_OFF_PATH = 0.02  # metres of any keypoint from between the frames beside, from which on a hand is begun there as well


@dataclass(frozen=True, kw_only=True)
class PastFrame:
    """A frame that may be estimated again, its pictures reduced to packed silhouettes."""

    time_s: float
    views: tuple[View, ...]
    """Views with their keypoints alone."""
    masks: tuple[PackedMask | None, ...]
    keypoints: Float[Tensor, "21 3"] | None
    """Keypoints of the hand as it was found, metres; None where it was lost."""
    score: float
    """How much of the silhouettes the hand explained, 0 to 1; 0 where it was lost."""
    pose: Float[Tensor, "36"] | None = None
    """The hand's pose, with the root's whole rotation vector; None where it was lost or is not known."""
    hull: Hull | None = None
    """Hull of the silhouettes about that hand, where one was carved: most of the time of another estimate."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        keypoints: Float[Tensor, "21 3"] | None,
        score: float,
        pose: Float[Tensor, "36"] | None = None,
    ) -> "PastFrame":
        """The record of a scene and of what was found in it."""
        masks = [
            own if plane is None else plane > 0.5 for own, plane in zip(scene.masks, scene.probabilities, strict=True)
        ]
        hull: Hull | None = scene.kept.get(HULL)
        return cls(
            time_s=scene.time_s,
            views=tuple(View(keypoints=view.keypoints) for view in scene.views),
            masks=tuple(None if mask is None else PackedMask.of(mask) for mask in masks),
            keypoints=keypoints,
            score=score,
            pose=pose,
            hull=None if hull is None else hull.with_observations(()),
        )

    @property
    def is_told(self) -> bool:
        """Whether a hand was found that detectors see in two pictures or more: what they tell was compared with it."""
        return self.keypoints is not None and sum(view.keypoints is not None for view in self.views) > 1

    def scene(self, device: torch.device) -> Scene:
        """The scene in which a tracker follows a hand, on its device."""
        masks = tuple(None if mask is None else mask.mask().to(device) for mask in self.masks)
        kept: dict[Hashable, Any] = {} if self.hull is None else {HULL: self.hull}
        return Scene(views=self.views, masks=masks, probabilities=(None,) * len(masks), time_s=self.time_s, kept=kept)


class Smoother:
    """Keeps the last frames of one tracker, and corrects them by what comes after."""

    def __init__(self, tracker: Tracker, window_s: float) -> None:
        """window_s: how far a hand is followed back; 0 corrects nothing."""
        self._tracker, self._window_s = tracker, window_s
        self._past: deque[PastFrame] = deque()

    def remember(self, past: PastFrame) -> None:
        """Keep one more frame, after the last one."""
        self._past.append(past)
        while self._past and self._past[0].time_s < past.time_s - self._window_s - _CLOCK_S:
            self._past.popleft()

    def corrections(self, state: TrackerState, estimate: Estimate) -> list[Estimate]:
        """Better estimates of earlier frames, the latest first; mostly none.

        state, estimate: as `Tracker.step` returned them for a frame that is not remembered yet.
        """
        if self._window_s <= 0 or state.hand is None or estimate.keypoints is None:
            return []
        followed = self._followed_back(state, estimate) if self._is_news(estimate) else []
        return [self._tracker.told(state, one) for one in followed or self._begun_between(state, estimate)]

    def _followed_back(self, state: TrackerState, estimate: Estimate) -> list[FollowedInto]:
        """The hand of this frame in the frames before which it explains better, the latest first."""
        assert state.hand is not None
        assert estimate.keypoints is not None
        hand, now, time_s = self._tracker.at_rest(state.hand), estimate.keypoints, estimate.time_s
        before: list[PastFrame] = []
        after: list[Estimate] = []
        all_followed: list[FollowedInto] = []
        gains = [0.0]
        for past in reversed(self._past):
            is_out = past.time_s < estimate.time_s - self._window_s - _CLOCK_S
            is_in_vain = gains[-1] < max(gains) - _HOPELESS or len(gains) > gains.index(max(gains)) + _IN_VAIN
            if is_out or is_in_vain or past.is_told:
                break
            followed = self._tracker.follow(state, hand, past.scene(self._tracker.device), time_s - past.time_s)
            if followed is None or _distance(followed.estimate.keypoints, past.keypoints) < _SAME:
                break
            hand, found = followed.hand, followed.estimate
            time_s = past.time_s
            if past.keypoints is None and not self._tracker.is_sure(found):
                break
            before.append(past)
            after.append(found)
            all_followed.append(followed)
            gains.append(self._gain(before, after, now))
        changed = max(range(len(gains)), key=gains.__getitem__)
        for place, found in enumerate(after[:changed]):
            self._correct(place, found)
        return all_followed[:changed]

    def _begun_between(self, state: TrackerState, estimate: Estimate) -> list[FollowedInto]:
        """The hand of the last frame, begun between those of the frames beside it, where it is not near there and is
        explained better so."""
        if len(self._past) < 2:
            return []
        before, past, now = self._past[-2], self._past[-1], estimate.keypoints
        if before.pose is None or before.keypoints is None or past.keypoints is None or past.is_told:
            return []
        assert now is not None
        assert estimate.pose is not None
        share = (past.time_s - before.time_s) / (estimate.time_s - before.time_s)
        if _largest(past.keypoints, torch.lerp(before.keypoints, now, share)) <= _OFF_PATH:
            return []
        begin = HandPose.of(before.pose)
        between = begin.retract(share * begin.step_to(HandPose.of(estimate.pose)))
        begun = self._tracker.begun(state, between, past.scene(self._tracker.device))
        if begun is None or _largest(past.keypoints, begun.estimate.keypoints) < _SAME:
            return []
        if self._gain([past], [begun.estimate], now) <= 0:
            return []
        self._correct(0, begun.estimate)
        return [begun]

    def _correct(self, place: int, found: Estimate) -> None:
        """Remember another hand of a frame. place: how many frames came after it."""
        index = len(self._past) - 1 - place
        self._past[index] = replace(self._past[index], keypoints=found.keypoints, score=found.score, pose=found.pose)

    def _is_news(self, estimate: Estimate) -> bool:
        if estimate.is_new:
            return True
        return len(self._past) > 0 and _distance(self._past[-1].keypoints, estimate.keypoints) > _LEAP

    def _gain(self, before: list[PastFrame], after: list[Estimate], now: Tensor) -> float:
        """Score by which the last frames are explained better by other hands, the latest first, for their motion."""
        was = [now, *(past.keypoints for past in before)]
        then = [now, *(found.keypoints for found in after)]
        if len(self._past) > len(before):
            earlier = self._past[-1 - len(before)].keypoints
            was, then = [*was, earlier], [*then, earlier]
        explained = math.fsum(new.score - old.score for new, old in zip(after, before, strict=True))
        return explained - _MOTION * (_motion(then) - _motion(was))


def _motion(path: list[Tensor | None]) -> float:
    """Metres, summed over a path of hands, in the mean over the keypoints; nothing where one is missing."""
    pairs = itertools.pairwise(path)
    return math.fsum(_distance(one, other) for one, other in pairs if one is not None and other is not None)


def _distance(one: Tensor | None, other: Tensor | None) -> float:
    if one is None or other is None:
        return math.inf
    return float((one - other).norm(dim=-1).mean())


def _largest(one: Tensor, other: Tensor | None) -> float:
    return math.inf if other is None else float((one - other).norm(dim=-1).max())
