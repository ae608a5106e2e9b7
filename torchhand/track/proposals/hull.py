"""Several cameras: other turns, fingers and places of the hand in the hull of its silhouettes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from torchhand.hand import HandPose
from torchhand.track.knowledge import Keyframe, TrackerState
from torchhand.track.multiview import (
    HULL,
    FrameFitter,
    HandProposer,
    Hull,
    HullFit,
    HullUpdate,
    best_of,
    hull_about,
    hull_anywhere,
)
from torchhand.track.proposals.protocol import Occasion, Proposals, ProposalSource, Proposed
from torchhand.track.scene import Candidate, Health, Scene

_MAX_KEYFRAMES = 6  # keyframes that are tried
_ALTERNATIONS = 3  # of turns and fingers: after a fast turn one leads to the other


@dataclass(frozen=True, kw_only=True)
class HullProposals:
    """Update rule and health that all sources of one rig have in common."""

    update: HullUpdate
    health: Health

    @property
    def fitter(self) -> FrameFitter:
        return self.update.fitter

    def about(
        self, best: Candidate | None, scene: Scene, state: TrackerState, fit: Callable[..., HullFit | None]
    ) -> Proposals:
        """The best hand so far fitted once more by `fit`, a method of the fitter that is given the hull about it, its
        pose, the shape and the masks; no proposals where there is no hand."""
        if best is None or state.shape is None:
            return Proposals()
        hull = hull_about(self.fitter, scene, best.pose, state.shape)
        return self.proposed(fit(hull, best.pose.normalized(), shape=state.shape, masks=scene.masks), hull)

    def proposed(self, fit: HullFit | None, hull: Hull, shape: Float[Tensor, "shape"] | None = None) -> Proposals:
        """A fitted hand as a proposal. shape: the proportions that it was fitted with, where those are new."""
        hands = []
        candidate = None if fit is None else self.update.candidate(fit)
        if fit is not None and candidate is not None:
            hands.append(Proposed(pose=candidate.pose, covariance=fit.covariance, candidate=candidate, shape=shape))
        has_foreground = bool(hands) or len(hull.views) > 0
        return Proposals(
            hands=tuple(hands), reason=hull.reason or "no hand fits the hull", has_foreground=has_foreground
        )


@dataclass(frozen=True, kw_only=True)
class KeyframeHere:
    """The keyframe of the scene's own time, wherever the followed hand is not borne out."""

    occasion: ClassVar[Occasion] = "always"
    shared: HullProposals

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Proposals of at most one hand."""
        here = [one for one in state.keyframes if one.is_of(scene.time_s)]
        is_followed = not self.shared.health.is_degraded(best, state.usual_score)
        if not here or state.shape is None or is_followed:
            return Proposals()
        fitter, pose = self.shared.fitter, here[0].pose.normalized()
        hull = fitter.hull_about(pose, state.shape, scene.masks)
        scene.kept[HULL] = hull
        return self.shared.proposed(fitter.refine(hull, pose, state.shape, scene.masks), hull)


@dataclass(frozen=True, kw_only=True)
class Refit:
    """The followed hand itself, fitted without a prediction, and with larger steps where that explains no more: a
    finger that stayed behind may still be drawn in."""

    occasion: ClassVar[Occasion] = "declining"
    shared: HullProposals

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Proposals of at most one hand."""

        def is_enough(fit: HullFit) -> bool:
            candidate = self.shared.update.candidate(fit)
            return candidate is not None and self.shared.health.better(best, candidate, None) is candidate

        return self.shared.about(best, scene, state, partial(self.shared.fitter.refine, is_enough=is_enough))


@dataclass(frozen=True, kw_only=True)
class SeenHands:
    """A hand as the views by themselves are read to show it, wherever one was followed."""

    occasion: ClassVar[Occasion] = "degraded"
    shared: HullProposals
    propose: HandProposer

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Proposals of at most one hand."""
        fitter = self.shared.fitter
        shape = fitter.hand.kinematics.default_shape if state.shape is None else state.shape
        hull = hull_anywhere(fitter, scene, shape)
        detected = self.propose.detected(scene, shape)
        fit = fitter.fit_proposed(hull, detected, shape, scene.masks, tries_fingers=False)
        if fit is None or not fit.is_good:
            fit = best_of([fit, fitter.fit_proposed(hull, self.propose(scene, shape), shape, scene.masks)])
        return self.shared.proposed(fit, hull, shape if state.shape is None else None)


@dataclass(frozen=True, kw_only=True)
class Turns:
    """The hand turned about its palm, as after a fast turn of the forearm."""

    occasion: ClassVar[Occasion] = "degraded"
    shared: HullProposals

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Proposals of at most one hand."""
        return self.shared.about(best, scene, state, self.shared.fitter.vary_orientation)


@dataclass(frozen=True, kw_only=True)
class Fingers:
    """The hand in its place with single digits in other postures, or in the postures of the nearest keyframes."""

    occasion: ClassVar[Occasion] = "degraded"
    shared: HullProposals

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Proposals of at most one hand."""
        others = nearest_keyframes(state.keyframes, scene.time_s)
        return self.shared.about(best, scene, state, partial(self.shared.fitter.vary_fingers, others=others))


@dataclass(frozen=True, kw_only=True)
class Keyframes:
    """A lost hand where the nearest keyframes were, anywhere in the hull."""

    occasion: ClassVar[Occasion] = "degraded"
    shared: HullProposals

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Proposals of at most one hand; none while the followed one is not failing."""
        if state.shape is None or not self.shared.health.is_failing(best):
            return Proposals()
        hull = hull_anywhere(self.shared.fitter, scene, state.shape)
        others = nearest_keyframes(state.keyframes, scene.time_s)
        return self.shared.proposed(self.shared.fitter.fit_from(hull, others, state.shape, scene.masks), hull)


@dataclass(frozen=True, kw_only=True)
class HullSearch:
    """A search in the hull without any guess."""

    occasion: ClassVar[Occasion] = "search"
    shared: HullProposals

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Proposals of at most one hand."""
        shape = self.shared.fitter.hand.kinematics.default_shape if state.shape is None else state.shape
        hull = hull_anywhere(self.shared.fitter, scene, shape)
        new_shape = shape if state.shape is None else None
        found = self.shared.fitter.search(hull, shape, scene.masks, is_quick=state.has_started)
        return self.shared.proposed(found, hull, new_shape)


def nearest_keyframes(keyframes: Sequence[Keyframe], time_s: float) -> list[HandPose]:
    """Poses of the keyframes that are nearest in time, nearest first."""
    ordered = sorted(keyframes, key=lambda one: abs(one.time_s - time_s))
    return [one.pose.normalized() for one in ordered[:_MAX_KEYFRAMES]]


def hull_sources(update: HullUpdate, health: Health, propose: HandProposer) -> tuple[ProposalSource, ...]:
    """All sources of one rig in the order in which they are asked."""
    shared = HullProposals(update=update, health=health)
    alternation = (Turns(shared=shared), Fingers(shared=shared)) * _ALTERNATIONS
    return (
        KeyframeHere(shared=shared),
        Refit(shared=shared),
        SeenHands(shared=shared, propose=propose),
        *alternation,
        Keyframes(shared=shared),
        HullSearch(shared=shared),
    )
