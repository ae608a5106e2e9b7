"""A hand that was found anew, followed back into the moments before.

After a fast turn a tracker may hold a hand that explains the silhouettes well enough, until a better one is found. The
moments before are then seen again: up to one of them the hand stays as it was followed, and from there on it is the one
that was found, followed backwards. That moment is where the silhouettes of all are explained best for the least motion
(the most probable path of two: Viterbi 1967).
"""

import itertools
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchhand.fit.hull import MIN_COVERED
from torchhand.track import TrackerState
from torchhand.track.multiview.silhouettes import Masks, PackedMask
from torchhand.track.multiview.tracker import MultiViewEstimate, MultiViewMemory, MultiViewTracker

_MOTION = 3.0  # score that a metre of motion is worth, in the mean over the keypoints
_HOPELESS = 0.1  # gain less than with fewer moments, from which on no more are looked at
_LEAP = 0.015  # metres from one moment to the next, in the mean over the keypoints, that few hands move
_SAME = 0.002  # metres between two hands, in the same mean, that are one


@dataclass(frozen=True, kw_only=True)
class SeenMoment:
    """A moment that may be seen again."""

    moment: int
    masks: Sequence[PackedMask | None]
    """One per view; None where nothing is known of it."""
    keypoints: Float[Tensor, "21 3"] | None
    """Of the hand as it was found, metres; None where it was lost."""
    score: float
    """How much of the silhouettes that explains, 0 to 1; 0 where the hand was lost."""
    seconds: float = 0.0
    """What it took to find it."""

    @classmethod
    def of(
        cls,
        moment: int,
        masks: Masks,
        keypoints: Float[Tensor, "21 3"] | None,
        score: float,
        *,
        seconds: float = 0.0,
    ) -> "SeenMoment":
        """With its masks packed."""
        packed = [None if mask is None else PackedMask.of(mask) for mask in masks]
        return cls(moment=moment, masks=packed, keypoints=keypoints, score=score, seconds=seconds)


class Hindsight:
    """Keeps the last moments of one tracker, and corrects them by what comes after."""

    def __init__(self, tracker: MultiViewTracker) -> None:
        """How many moments are kept is told by the tracker's settings and frame rate."""
        self._tracker = tracker
        self._seen: deque[SeenMoment] = deque(maxlen=tracker.moments_back)

    def remember(self, seen: SeenMoment) -> None:
        """One more moment, the next after the last one."""
        self._seen.append(seen)

    def look_back(
        self, moment: int, state: TrackerState | None, memory: MultiViewMemory, estimate: MultiViewEstimate
    ) -> list[tuple[SeenMoment, MultiViewEstimate]]:
        """Earlier moments with better estimates than those so far, the latest first; mostly none.

        Only a hand that was found anew, or that leapt to where it is, is followed back.

        state, memory, estimate: as `MultiViewTracker.step` returned them for this moment, which is not remembered yet.
        """
        if state is None or estimate.keypoints is None or not self._is_news(estimate):
            return []
        state = self._tracker.at_rest(state)
        before: list[SeenMoment] = []
        after: list[MultiViewEstimate] = []
        gains = [0.0]
        now = estimate.keypoints
        for place in range(len(self._seen)):
            seen = self._seen[-1 - place]
            if seen.moment != moment - place - 1 or gains[-1] < max(gains) - _HOPELESS:
                break
            followed = self._tracker.follow(state, memory, [mask and mask.mask() for mask in seen.masks])
            if followed is None or _apart(followed[1].keypoints, seen.keypoints) < _SAME:
                break
            state, found = followed
            if seen.keypoints is None and not self._is_sure(found):
                break
            before.append(seen)
            after.append(found)
            gains.append(self._gain(before, after, now))
        changed = max(range(len(gains)), key=gains.__getitem__)
        better = list(zip(before[:changed], after[:changed], strict=True))
        for place, (seen, found) in enumerate(better):
            self._seen[-1 - place] = replace(seen, keypoints=found.keypoints, score=found.score)
        return better

    def _is_news(self, estimate: MultiViewEstimate) -> bool:
        return estimate.is_new or (len(self._seen) > 0 and _apart(self._seen[-1].keypoints, estimate.keypoints) > _LEAP)

    def _is_sure(self, found: MultiViewEstimate) -> bool:
        """Whether that much is explained that there is a hand, and no arm or half a hand."""
        settings = self._tracker.settings
        covered = found.covered_share or 0.0
        return (found.overlap or 0.0) >= settings.loss.start_overlap and covered >= MIN_COVERED

    def _gain(self, before: list[SeenMoment], after: list[MultiViewEstimate], now: Tensor) -> float:
        """By how much the last moments are explained better by the hand that was followed back through them."""
        was = [now, *(seen.keypoints for seen in before)]
        then = [now, *(found.keypoints for found in after)]
        if len(self._seen) > len(before):
            earlier = self._seen[-1 - len(before)].keypoints
            was, then = [*was, earlier], [*then, earlier]
        explained = math.fsum(new.score - old.score for new, old in zip(after, before, strict=True))
        return explained - _MOTION * (_motion(then) - _motion(was))


def _motion(path: list[Tensor | None]) -> float:
    """Metres, summed over a path of hands, in the mean over the keypoints; nothing where one is missing."""
    pairs = itertools.pairwise(path)
    return math.fsum(_apart(one, other) for one, other in pairs if one is not None and other is not None)


def _apart(one: Tensor | None, other: Tensor | None) -> float:
    if one is None or other is None:
        return math.inf
    return float((one - other).norm(dim=-1).mean())
