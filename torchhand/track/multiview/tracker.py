"""The tracker of several cameras: predict, carve, fit, judge; search afresh where that fails.

A tracker is a value: `step` takes a state, what is remembered and the silhouettes of a moment, and returns the next
state and the estimate. Poses are in the world frame of the cameras.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera, vector_from_rotation
from torchhand.hand import Hand
from torchhand.numerics import Gaussian, predict_linear, single_threaded
from torchhand.numerics.conditioning import with_marginal
from torchhand.track.estimate import posed_belief
from torchhand.track.hull_fit import HullFit
from torchhand.track.multiview.agreement import mean_overlap, score_of
from torchhand.track.multiview.fitting import Anchor, MomentFitter, Placed
from torchhand.track.multiview.hulls import Hull
from torchhand.track.multiview.settings import MultiViewSettings
from torchhand.track.multiview.silhouettes import Masks
from torchhand.track.prior import Kind, kind_of
from torchhand.track.rebasing import Rebasing
from torchhand.track.state import Status, TrackerState
from torchhand.track.tracker import start_spread

_USUAL, _AT_BEST = 0.9, 0.99  # shares of the usual score, and of the one at best, that outlast a frame
_UNEASY = 0.03  # score less than at best, from which on a followed hand is fitted once more as if it were off
_SETTLE_EVERY = 10  # frames from one such fit to the next at least
_TURNED = 0.12  # score that a hand turned by half a turn must be ahead
_MOST_VARIED = 6  # times that turns and digits of a doubtful hand are varied at most
_NEAREST = 6  # hands of other moments that are tried


@dataclass(frozen=True, kw_only=True)
class MultiViewMemory:
    """What outlasts a loss."""

    shape: Float[Tensor, "shape"]
    score: float = 0.0
    """Usual score of the frames so far, as `Placed.score`; 0 before there is one."""
    best_score: float = 0.0
    """The same at best, which is forgotten slowly."""
    frames_since_settled: int = 0
    """Frames since a followed hand was fitted once more as if it were off."""
    frames_since_search: int = 0
    search_after: int = 0
    """Frames after which a search without any guess is due."""
    has_started: bool = False
    """Whether a hand was ever found."""


@dataclass(frozen=True, kw_only=True)
class MultiViewEstimate:
    """One moment's result. Where status is lost or no_hand everything but overlap, views and reason is None."""

    status: Status
    pose: Float[Tensor, "36"] | None = None
    """Full pose in the world frame with the root's rotation vector; metres and radians."""
    pose_std: Float[Tensor, "36"] | None = None
    """Standard deviations, 0 for DOFs that are held; those of the root's rotation are of a small turn in the world's
    axes."""
    keypoints: Float[Tensor, "21 3"] | None = None
    """Metres, world frame."""
    keypoints_cov: Float[Tensor, "21 3 3"] | None = None
    """Square metres, world frame."""
    overlaps: Float[Tensor, "views"] | None = None
    """Intersection over union with every view's silhouette; NaN in views that are missing."""
    inside_share: float | None = None
    """Share of the skin inside the hull (paper 002's rate of convergence)."""
    covered_share: float | None = None
    """Share of the silhouettes' edges that the skin explains."""
    views: int = 0
    """Views that the hull was carved from."""
    reason: str = ""
    is_new: bool = False
    """Whether the hand was found otherwise than by following it from the moment before."""

    @property
    def overlap(self) -> float | None:
        """Mean over the views; None without an estimate."""
        return None if self.overlaps is None else mean_overlap(self.overlaps)

    @property
    def score(self) -> float:
        """As `Placed.score`; 0 without an estimate."""
        overlap, covered = self.overlap, self.covered_share
        return 0.0 if overlap is None or covered is None else score_of(overlap, covered)


class MultiViewTracker:
    """Follows one hand of a known side through the silhouettes of several cameras.

    Computes on the CPU, in float64 but for the skin's distances. The same silhouettes give the same numbers.
    """

    def __init__(
        self,
        hand: Hand,
        cameras: Sequence[Camera],
        frames_per_second: float,
        settings: MultiViewSettings | None = None,
    ) -> None:
        """hand: in float64. cameras: without distortion, as `ViewSilhouettes.cameras`.

        Raises ValueError for a frame rate that cannot be, and for cameras that see no volume together where no cube is
        given.
        """
        if not (math.isfinite(frames_per_second) and frames_per_second > 0):
            raise ValueError(f"frames_per_second: expected a finite number above 0, got {frames_per_second!r}")
        self.settings = s = settings or MultiViewSettings()
        self.fits = MomentFitter(hand, cameras, s)
        self.hand, self.space = hand, self.fits.space
        self._rebased = Rebasing(space=self.space, skeleton=hand.kinematics.skeleton)
        self._kinds: list[Kind] = [kind_of(name) for name in self.space.free_names]
        noise = {"translation": s.noise.translation, "rotation": s.noise.rotation, "angle": s.noise.angle}
        density = torch.tensor([noise[kind] ** 2 for kind in self._kinds], dtype=torch.float64)
        step_s = 1.0 / frames_per_second
        self._transition = s.motion.transition(step_s, self.space.size)
        self._process_noise = s.motion.process_noise(step_s, density)
        self.moments_back = round(s.look_back_s * frames_per_second)
        """How many moments may be seen again, by `Hindsight`."""

    # ------------------------------------------------------------------ a moment

    @single_threaded()
    def step(
        self,
        state: TrackerState | None,
        memory: MultiViewMemory,
        masks: Masks,
        anchors: Mapping[int, Anchor] | None = None,
        moment: int | None = None,
    ) -> tuple[TrackerState | None, MultiViewMemory, MultiViewEstimate]:
        """The next state, what is remembered, and the estimate of this moment.

        anchors: hands that were found before, such as by `acquaint`, by their moments. One of this `moment` always
        takes part as a start; the nearest ones do where the hand is lost or doubtful, their postures too.

        A search without any guess comes last, and the less often the longer it finds nothing. A hand found again after
        a lost frame is `recovered`.
        """
        anchors = anchors or {}
        memory = replace(
            memory,
            frames_since_search=memory.frames_since_search + 1,
            frames_since_settled=memory.frames_since_settled + 1,
        )
        predicted = None if state is None else self._predicted(state)
        here = None if moment is None else anchors.get(moment)
        followed, hull = None, None
        if predicted is not None:
            followed, hull = self._followed(predicted, here, memory, masks)
        best, facing = followed, None if predicted is None else predicted.reference
        if here is not None:
            hull = self.fits.hull_about(here, memory.shape, masks)
            best = self._better(best, self.fits.settled(hull, here, memory.shape, masks), facing)
        if self._is_doubtful(best, memory):
            near = [anchors[key] for key in sorted(anchors, key=lambda key: abs(key - (moment or 0)))][:_NEAREST]
            best, hull, memory = self._reconsidered(best, hull, near, memory, masks, facing)
        elif best is not None and hull is not None and self._is_uneasy(best, memory):
            memory = replace(memory, frames_since_settled=0)
            best = self._better(best, self.fits.settled(hull, best.anchor, memory.shape, masks), facing)
        if best is None:
            return self._without(predicted, memory, hull)
        return self._taken(best, followed, predicted, memory)

    def at_rest(self, state: TrackerState) -> TrackerState:
        """The same hand with speeds of which nothing is known, from where it can be followed into either time."""
        count, belief = self.space.size, state.belief
        return replace(state, belief=self._at_rest(belief.mean[:count], belief.covariance[:count, :count]))

    def follow(
        self, state: TrackerState, memory: MultiViewMemory, masks: Masks
    ) -> tuple[TrackerState, MultiViewEstimate] | None:
        """The hand of a state in the next moment, with nothing else looked for; None where it does not fit there."""
        predicted = self._predicted(state)
        placed, _ = self._followed(predicted, None, memory, masks)
        if placed is None or self._is_failing(placed) or not bool(placed.fit.covariance.isfinite().all()):
            return None
        following = self._updated(predicted, placed.fit)
        return following, self._estimate("tracked", following, placed, memory)

    def _reconsidered(
        self,
        best: Placed | None,
        hull: Hull | None,
        anchors: Sequence[Anchor],
        memory: MultiViewMemory,
        masks: Masks,
        facing: Tensor | None,
    ) -> tuple[Placed | None, Hull | None, MultiViewMemory]:
        """Other turns, other postures, other moments' hands, and when it is time a search, until the hand is no longer
        in doubt."""
        loss, shape, fits = self.settings.loss, memory.shape, self.fits
        is_failing = self._is_failing(best)
        if best is not None and hull is not None:
            best = self._varied(best, hull, anchors, memory, masks, facing)
        if is_failing or hull is None:  # it may be anywhere
            hull = fits.hull_anywhere(shape, masks)
            best = self._better(best, fits.from_anchors(hull, anchors, shape, masks), facing)
        is_due = memory.frames_since_search >= memory.search_after
        if hull.target is None or not is_due or not self._is_doubtful(best, memory):
            return best, hull, memory
        found = fits.searched(hull if is_failing else fits.hull_anywhere(shape, masks), shape, masks)
        has_found = found is not None and found.overlap >= loss.start_overlap
        after = loss.search_every if has_found else min(max(2 * memory.search_after, 1), loss.search_seldom)
        memory = replace(memory, frames_since_search=0, search_after=after)
        return self._better(best, found, facing), hull, memory

    def _varied(
        self,
        best: Placed,
        hull: Hull,
        anchors: Sequence[Anchor],
        memory: MultiViewMemory,
        masks: Masks,
        facing: Tensor | None,
    ) -> Placed:
        """Other turns and other digits in alternation, each from the best so far, as after a fast turn one leads to the
        other; until neither helps or the hand is no longer in doubt. Before that, the hand itself with larger steps."""
        fits, shape, in_vain = self.fits, memory.shape, 0
        best = self._better(best, fits.settled(hull, best.anchor, shape, masks), facing) or best
        if not self._is_doubtful(best, memory):
            return best
        for time in range(_MOST_VARIED):
            if time % 2 == 0:
                other = fits.turned(hull, best.anchor, shape, masks)
            else:
                other = fits.with_other_digits(hull, best.anchor, anchors, shape, masks)
            before, best = best, self._better(best, other, facing) or best
            in_vain = in_vain + 1 if best is before else 0
            if in_vain == 2 or not self._is_doubtful(best, memory):
                break
        return best

    def _followed(
        self, predicted: TrackerState, here: Anchor | None, memory: MultiViewMemory, masks: Masks
    ) -> tuple[Placed | None, Hull]:
        """The hand fitted from the prediction; where it fails, once more without the view that agrees least."""
        own = Anchor(pose=self._rebased.pose(predicted), root_reference=predicted.reference)
        starts = [own] if here is None else [own, here]
        placed, hull = self._fitted(predicted, starts, memory, masks)
        if placed is None or not self._is_failing(placed) or len(hull.views) <= self.settings.loss.fewest_views:
            return placed, hull
        worst = int(placed.overlaps.nan_to_num(torch.inf).argmin())
        others = [None if view == worst else mask for view, mask in enumerate(masks)]
        again, second = self._fitted(predicted, starts, memory, others)
        return (placed, hull) if self._better(placed, again, None) is placed else (again, second)

    def _fitted(
        self, predicted: TrackerState, starts: Sequence[Anchor], memory: MultiViewMemory, masks: Masks
    ) -> tuple[Placed | None, Hull]:
        count, belief = self.space.size, predicted.belief
        hull = self.fits.hull_about(starts[0], memory.shape, masks)
        mean, covariance = belief.mean[:count], belief.covariance[:count, :count]
        return self.fits.expected(hull, starts, mean, covariance, memory.shape, masks), hull

    def _better(self, first: Placed | None, second: Placed | None, facing: Tensor | None) -> Placed | None:
        """The second where it explains enough more than the first: the more, the farther it is turned from where the
        hand is expected to face, for a hand and its mirror image fill a hull nearly alike."""
        if first is None or second is None:
            return first or second
        margin = self.settings.loss.better_by
        if facing is not None:
            traces = [float((facing * one.fit.root_reference).sum()) for one in (first, second)]
            margin += _TURNED * max(0.0, traces[0] - traces[1]) / 4  # of half a turn: 4
        return second if second.score > first.score + margin else first

    def _is_failing(self, placed: Placed | None) -> bool:
        return placed is None or placed.overlap < self.settings.loss.min_overlap

    def _is_doubtful(self, placed: Placed | None, memory: MultiViewMemory) -> bool:
        if placed is None or self._is_failing(placed):
            return True
        return not bool(placed.fit.is_good) or placed.score < memory.score - self.settings.loss.doubt_drop

    def _is_uneasy(self, placed: Placed, memory: MultiViewMemory) -> bool:
        return memory.frames_since_settled >= _SETTLE_EVERY and placed.score < memory.best_score - _UNEASY

    # ------------------------------------------------------------------ what follows

    def _without(
        self, predicted: TrackerState | None, memory: MultiViewMemory, hull: Hull | None
    ) -> tuple[TrackerState | None, MultiViewMemory, MultiViewEstimate]:
        reason = "no hand was looked for in this frame" if hull is None else hull.reason or "no hand fits the hull"
        status: Status = "lost" if memory.has_started and (hull is None or hull.views) else "no_hand"
        estimate = MultiViewEstimate(status=status, reason=reason, views=0 if hull is None else len(hull.views))
        return self._given_up(predicted), memory, estimate

    def _given_up(self, predicted: TrackerState | None) -> TrackerState | None:
        if predicted is None or predicted.failures + 1 >= self.settings.loss.patience:
            return None
        return replace(predicted, failures=predicted.failures + 1)

    def _taken(
        self,
        best: Placed,
        followed: Placed | None,
        predicted: TrackerState | None,
        memory: MultiViewMemory,
    ) -> tuple[TrackerState | None, MultiViewMemory, MultiViewEstimate]:
        loss, is_new = self.settings.loss, best is not followed
        least = loss.start_overlap if is_new else loss.min_overlap
        if best.overlap < least or not bool(best.fit.covariance.isfinite().all()):
            reason = f"overlap {best.overlap:.2f} with the silhouettes"
            status: Status = "lost" if memory.has_started else "no_hand"
            return self._given_up(predicted), memory, MultiViewEstimate(status=status, reason=reason, views=best.views)
        following = self._begun(best.fit) if is_new or predicted is None else self._updated(predicted, best.fit)
        was_lost = predicted is None and memory.has_started
        usual, at_best = (
            max(best.score, share * before + (1 - share) * best.score)
            for share, before in ((_USUAL, memory.score), (_AT_BEST, memory.best_score))
        )
        memory = replace(memory, score=usual, best_score=at_best, has_started=True)
        estimate = self._estimate("recovered" if was_lost else "tracked", following, best, memory)
        return following, memory, replace(estimate, is_new=is_new)

    def _predicted(self, state: TrackerState) -> TrackerState:
        return replace(state, belief=predict_linear(state.belief, self._transition, self._process_noise))

    def _begun(self, fit: HullFit) -> TrackerState:
        """A filter that starts at a fitted hand."""
        state = TrackerState(
            belief=self._at_rest(self.space.own(fit.pose), fit.covariance),
            base=self.space.constant,
            reference=fit.root_reference,
            start_reference=fit.root_reference,
        )
        return self._rebased(state)

    def _at_rest(self, free: Float[Tensor, "free"], covariance: Float[Tensor, "free free"]) -> Gaussian:
        """A belief of a pose, with speeds of which nothing is known."""
        spread = start_spread(self._kinds, self.settings.motion.order)
        whole = spread.diag_embed()
        whole[: len(free), : len(free)] = covariance
        return Gaussian(torch.cat((free, free.new_zeros(len(spread) - len(free)))), whole)

    def _updated(self, predicted: TrackerState, fit: HullFit) -> TrackerState:
        """The prediction corrected by the fit, whose prior it was; with the torques, the fit alone."""
        if self.settings.fitting == "torque":
            return self._begun(fit)
        vector = vector_from_rotation(fit.root_reference @ predicted.reference.mT)
        free = self.space.own(torch.cat((fit.pose[:3], vector, fit.pose[6:])))
        belief = with_marginal(predicted.belief, free, fit.covariance)
        return self._rebased(replace(predicted, belief=belief, failures=0))

    def _estimate(
        self, status: Status, state: TrackerState, placed: Placed, memory: MultiViewMemory
    ) -> MultiViewEstimate:
        posed = posed_belief(state, self.hand.kinematics, self.space, memory.shape)
        return MultiViewEstimate(
            status=status,
            pose=posed.pose,
            pose_std=posed.pose_std,
            keypoints=posed.keypoints,
            keypoints_cov=posed.keypoints_cov,
            overlaps=placed.overlaps,
            inside_share=float(placed.fit.inside_share),
            covered_share=float(placed.fit.covered_share),
            views=placed.views,
        )
