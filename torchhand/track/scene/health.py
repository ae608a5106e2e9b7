"""Whether a hand is still the one in the pictures: one measure for every tracker.

How often this is wrong stands in status_rates.json, with the likelihood ratio of right hands to others, its thresholds
at false-alarm rates, and the command that measured all of it (`torchhand measure_status`). The ratio itself does not
decide: its simulated hands are too clean. At 5 % of false alarms it would refuse a third of real photographs, and of
candidates on a real recording of one hand it would call 4 % failing where 1 % of simulated right hands are.
"""

from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchhand.errors import require
from torchhand.track.scene.candidate import Candidate

MAX_BEYOND = 0.08
"""Squares of the hand's length beyond the wrist that are no forearm. One in a hundred simulated right hands has more
than 0.04 (status_rates.json); with straight arms alone one in twenty photographs of hands has more than 0.074."""
ONE_PLACE_M = 0.1
"""Between the palms of two hands that are the same hand otherwise held, at most: half a hand's length."""
_MIN_IN_VIEW = 0.35  # share of the contour's points inside the picture, below which there is too little to judge by
_TURNED_BY_NETWORK = 0.25
"""By how much more the score of a hand turned by half a turn must be higher where the side that it shows is known from
its outline, and the network's view of the direction counts, of which it can make 0.3: in an eighth of the frames of a
real hand (`palm_gestures`) that hardly bears out the right side, for as long as a posture lasts. Alone it decides where
it leaves next to nothing to the followed side."""
_FACES_AWAY = 0.5  # of half a turn: a quarter turn about an axis in the palm
_KEYPOINT_WEIGHT = 0.3  # share of the score that detected keypoints have, where there are any
MIN_KEYPOINTS = 0.5  # agreement with detected keypoints, below which a detector found another hand
_DIRECTION_WEIGHT = 0.3  # share of the score that the network's view of the direction has, where there is one
_SURE_DIRECTION = 0.3  # agreement with that view which is as good as any: half of its hypotheses within its error
_MIN_DIRECTION = 0.12  # agreement below which it is in doubt
_RARE_SEARCH_EVERY = 60  # frames from one search that takes seconds to the next where they find nothing
_RARE_ALTERNATIVES_EVERY = 8  # frames from one attempt that takes tenths of a second to the next where they are in vain
_ALTERNATIVES_EVERY = 4  # the same after the first attempt
_FAILING_SOONER = 4  # times as often while the hand is failing or lost


@dataclass(frozen=True, kw_only=True)
class HealthSettings:
    """When a hand is failing, degraded, found."""

    min_overlap: float = 0.60
    """Smallest intersection over union of the model's and the pictures' silhouettes, mean over the views; 0 to 1."""
    min_edges: float = 0.40
    """Smallest share of the outer contour's points with an accepted edge; 0 to 1."""
    patience: int = 3
    """Frames in a row that may fail before the track is lost; 1 or more."""
    found_overlap: float = 0.60
    """Smallest overlap with which a proposed hand is taken as found; 0 to 1."""
    edge_weight: float = 0.0
    """Share of the score that edges have beside areas; 0 to 1."""
    memory: float = 1.0
    """Share of the usual score that outlasts a frame; 0 to 1, 1 keeps that of the start."""
    max_score_drop: float = 0.06
    """A hand whose score is lower than usual by more than this is degraded: alternatives are tried; 0 to 1."""
    max_unexplained: float = 0.012
    """Area of the picture's hand outside the model, in pieces as thick as a finger and in squares of the hand's length,
    beyond which it is degraded too; 0 or more."""
    better_by: float = 0.02
    """By how much the score of an alternative must be higher to take over; 0 to 1."""
    turned_by: float = 0.12
    """By how much more it must be higher where it is turned by half a turn, which a hand seldom does from one picture
    to the next; less for smaller turns; 0 to 1. Twice as much where only a network sees the hand, which began open."""
    nearer_by: float = 0.1
    """By how much more it must be higher where it lies half a hand's length away or more from a followed hand, and
    nearer to the camera: a hand with its arm looks much like a hand that is nearer; 0 to 1."""
    search_every: int = 5
    """Frames from one search without any guess to the next where the last one found a hand; 1 or more."""
    search_at_most_every: int = 5
    """Frames between searches where they keep finding nothing; `search_every` or more."""

    searches_when_failing: bool = True
    """Whether a failing or lost hand is searched at once, whatever the time since the last search."""
    alternatives_at_most_every: int = 1
    """Frames from one attempt to find a degraded hand otherwise to the next where these keep being in vain: 1 for one
    at every frame; 1 or more."""

    @property
    def first_search_after(self) -> int:
        """Frames from the start to the first search that is not urgent."""
        return self.search_every if self.searches_when_failing else 0

    def next_search(self, after: int, *, has_found: bool) -> int:
        """Frames to the next search, the last one having come after so many: the more, the longer nothing is found."""
        return self.search_every if has_found else min(max(2 * after, 1), self.search_at_most_every)

    def next_alternatives(self, after: int, *, has_helped: bool) -> int:
        """Frames to the next attempt to find a degraded hand otherwise, the last one having come after so many."""
        least = min(_ALTERNATIVES_EVERY, self.alternatives_at_most_every)
        return max(least, after // 2) if has_helped else min(max(2 * after, least), self.alternatives_at_most_every)

    def alternatives_are_due(self, since: int, after: int, *, is_failing: bool) -> bool:
        """Whether a degraded hand is to be found otherwise, so many frames after the last attempt."""
        return since >= (after // _FAILING_SOONER if is_failing else after)

    def for_rig(self) -> "HealthSettings":
        """For several cameras: what one view leaves unexplained the others decide, as they do how far a hand is. A
        search without a guess takes seconds, other hands tenths of one, so that they come the less often the longer
        they bring nothing better."""
        return replace(
            self,
            max_unexplained=float("inf"),
            nearer_by=0.0,
            searches_when_failing=False,
            search_at_most_every=max(self.search_at_most_every, _RARE_SEARCH_EVERY),
            alternatives_at_most_every=max(self.alternatives_at_most_every, _RARE_ALTERNATIVES_EVERY),
        )

    def __post_init__(self) -> None:
        shares = (
            "min_overlap",
            "min_edges",
            "found_overlap",
            "edge_weight",
            "memory",
        )
        for name in (*shares, "max_score_drop", "better_by", "turned_by", "nearer_by"):
            require(0 <= getattr(self, name) <= 1, f"health.{name}", "0 to 1", getattr(self, name))
        require(self.max_unexplained >= 0, "health.max_unexplained", "0 or more", self.max_unexplained)
        for name in ("patience", "search_every", "alternatives_at_most_every"):
            require(getattr(self, name) >= 1, f"health.{name}", "1 or more", getattr(self, name))
        is_rarer = self.search_at_most_every >= self.search_every
        require(is_rarer, "health.search_at_most_every", "search_every or more", self.search_at_most_every)


@dataclass(frozen=True, kw_only=True)
class Health:
    """Judges candidates by areas and edges of the silhouettes, and by detected keypoints."""

    settings: HealthSettings

    def score(self, candidate: Candidate) -> float:
        """How much of the pictures a candidate explains, 0 to 1."""
        weight = self.settings.edge_weight
        own = (1 - weight) * candidate.overlap + weight * candidate.edges
        if candidate.keypoints is not None:
            return (1 - _KEYPOINT_WEIGHT) * own + _KEYPOINT_WEIGHT * candidate.keypoints
        if candidate.direction is not None:
            share = min(1.0, candidate.direction / _SURE_DIRECTION)
            return (1 - _DIRECTION_WEIGHT) * own + _DIRECTION_WEIGHT * share
        return own

    def is_detected_elsewhere(self, candidate: Candidate) -> bool:
        """Whether a detector found another hand than this one."""
        return candidate.keypoints is not None and candidate.keypoints < MIN_KEYPOINTS

    def is_turned(self, candidate: Candidate) -> bool:
        """Whether a network sees the hand from another side, and no detector tells otherwise."""
        is_doubted = candidate.direction is not None and candidate.direction < _MIN_DIRECTION
        return candidate.keypoints is None and is_doubted

    def is_failing(self, candidate: Candidate | None) -> bool:
        """Whether the pictures do not bear a hand out."""
        if candidate is None:
            return True
        s = self.settings
        has_edges = candidate.edges >= s.min_edges and candidate.in_view >= _MIN_IN_VIEW
        return not has_edges or candidate.overlap < s.min_overlap

    def is_found(self, candidate: Candidate) -> bool:
        """Whether a proposed hand is one."""
        has_arm_only = candidate.agreement.mean_beyond <= MAX_BEYOND
        return not self.is_failing(candidate) and has_arm_only and candidate.overlap >= self.settings.found_overlap

    def is_gone(self, candidate: Candidate | None) -> bool:
        """Whether they speak so clearly against it that the track ends at once."""
        s = self.settings
        return candidate is None or (candidate.in_view < 0.5 * _MIN_IN_VIEW or candidate.overlap < 0.5 * s.min_overlap)

    def is_degraded(self, candidate: Candidate | None, usual: float) -> bool:
        """Whether alternatives should be tried. usual: the score of the frames before, 0 where there are none."""
        s = self.settings
        if candidate is None or self.is_failing(candidate) or not candidate.is_sound:
            return True
        if self.is_detected_elsewhere(candidate) or self.is_turned(candidate):
            return True
        has_dropped = self.score(candidate) < usual - s.max_score_drop
        return has_dropped or candidate.agreement.most_unexplained > s.max_unexplained

    def better(
        self,
        first: Candidate | None,
        second: Candidate | None,
        facing: Float[Tensor, "3 3"] | None,
        *,
        is_firm: bool = False,
    ) -> Candidate | None:
        """The second where it explains enough more than the first: the more, the farther it is turned away from
        `facing` (world_from_hand as expected), for a hand and its mirror image look nearly alike. The network's view of
        the direction decides between hands at one place; it says nothing of where the hand is. is_firm: whether
        `facing` is known otherwise than from that view, which then turns no hand over that explains more."""
        if first is None or second is None:
            return first or second
        is_elsewhere = float((first.palm - second.palm).norm()) > ONE_PLACE_M
        by_pictures = [self.score(replace(one, direction=None)) for one in (first, second)]
        scores = by_pictures if is_elsewhere else [self.score(one) for one in (first, second)]
        margin = self.settings.better_by
        if facing is not None:
            margin += self.settings.nearer_by * (is_elsewhere and bool(second.palm[2] < first.palm[2]))
            traces = [float((facing * one.rotation).sum()) for one in (first, second)]
            turn = max(0.0, traces[0] - traces[1]) / 4  # 1: half a turn
            is_by_network = is_firm and second.keypoints is None and second.direction is not None
            margin += turn * max(self.settings.turned_by, _TURNED_BY_NETWORK * is_by_network)
            if is_by_network and turn > _FACES_AWAY and by_pictures[1] < by_pictures[0]:
                return first
        return second if scores[1] > scores[0] + margin else first

    def usual(self, candidate: Candidate, before: float) -> float:
        """The usual score after one more frame."""
        keep, here = self.settings.memory, self.score(candidate)
        if before <= 0:
            return here
        return before if keep == 1 else max(here, keep * before + (1 - keep) * here)
