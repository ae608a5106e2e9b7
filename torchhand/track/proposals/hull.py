"""Several cameras: other turns, fingers and places of the hand in the hull of its silhouettes."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchhand.track.knowledge import Keyframe, TrackerState
from torchhand.track.multiview import (
    Anchor,
    Hull,
    HullUpdate,
    MomentFitter,
    Placed,
    anchor_of,
    hull_about,
    hull_anywhere,
)
from torchhand.track.proposals.protocol import Occasion, Proposals, ProposalSource, Proposed
from torchhand.track.scene import Candidate, Health, Scene

_NEAREST = 6  # keyframes that are tried
_ALTERNATIONS = 3  # of turns and fingers: after a fast turn one leads to the other


@dataclass(frozen=True, kw_only=True)
class HullProposals:
    """What all sources of one rig share."""

    update: HullUpdate
    health: Health

    @property
    def fits(self) -> MomentFitter:
        return self.update.fits

    def proposed(
        self, placed: Sequence[Placed | None], hull: Hull | None = None, shape: Float[Tensor, "shape"] | None = None
    ) -> Proposals:
        """Fitted hands as proposals. shape: the proportions that they were fitted with, where those are news."""
        hands = []
        for one in placed:
            candidate = None if one is None else self.update.candidate(one)
            if one is not None and candidate is not None:
                hands.append(
                    Proposed(pose=candidate.pose, covariance=one.fit.covariance, candidate=candidate, shape=shape)
                )
        reason = "no hand fits the hull" if hull is None else hull.reason or "no hand fits the hull"
        has_foreground = bool(hands) or (hull is not None and len(hull.views) > 0)
        return Proposals(hands=tuple(hands), reason=reason, has_foreground=has_foreground)


@dataclass(frozen=True, kw_only=True)
class KeyframeHere:
    """The keyframe of this very time, which always takes part."""

    shared: HullProposals

    @property
    def occasion(self) -> Occasion:
        return "always"

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand."""
        here = [one for one in state.keyframes if one.is_of(scene.time_s)]
        if not here or state.shape is None:
            return Proposals()
        fits, anchor = self.shared.fits, anchor_of(here[0].pose)
        hull = fits.hull_about(anchor, state.shape, scene.masks)
        scene.kept["hull"] = hull
        return self.shared.proposed([fits.settled(hull, anchor, state.shape, scene.masks)], hull)


@dataclass(frozen=True, kw_only=True)
class Refit:
    """The followed hand itself, fitted with larger steps: a finger that stayed behind may still be drawn in."""

    shared: HullProposals

    @property
    def occasion(self) -> Occasion:
        return "declining"

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand."""
        if best is None or state.shape is None:
            return Proposals()
        hull = hull_about(self.shared.fits, scene, best.pose, state.shape)
        placed = self.shared.fits.settled(hull, anchor_of(best.pose), state.shape, scene.masks)
        return self.shared.proposed([placed], hull)


@dataclass(frozen=True, kw_only=True)
class Turns:
    """The hand turned about its palm, as after a fast turn of the forearm."""

    shared: HullProposals

    @property
    def occasion(self) -> Occasion:
        return "degraded"

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand."""
        if best is None or state.shape is None:
            return Proposals()
        hull = hull_about(self.shared.fits, scene, best.pose, state.shape)
        placed = self.shared.fits.turned(hull, anchor_of(best.pose), state.shape, scene.masks)
        return self.shared.proposed([placed], hull)


@dataclass(frozen=True, kw_only=True)
class Fingers:
    """The hand in its place with single digits in other postures, or in the postures of the nearest keyframes."""

    shared: HullProposals

    @property
    def occasion(self) -> Occasion:
        return "degraded"

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand."""
        if best is None or state.shape is None:
            return Proposals()
        hull = hull_about(self.shared.fits, scene, best.pose, state.shape)
        others = nearest_keyframes(state.keyframes, scene.time_s)
        placed = self.shared.fits.with_other_digits(hull, anchor_of(best.pose), others, state.shape, scene.masks)
        return self.shared.proposed([placed], hull)


@dataclass(frozen=True, kw_only=True)
class Keyframes:
    """A lost hand where the nearest keyframes were, anywhere in the hull."""

    shared: HullProposals

    @property
    def occasion(self) -> Occasion:
        return "degraded"

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand; none while the followed one is not failing."""
        if state.shape is None or not self.shared.health.is_failing(best):
            return Proposals()
        hull = hull_anywhere(self.shared.fits, scene, state.shape)
        others = nearest_keyframes(state.keyframes, scene.time_s)
        return self.shared.proposed([self.shared.fits.from_anchors(hull, others, state.shape, scene.masks)], hull)


@dataclass(frozen=True, kw_only=True)
class HullSearch:
    """A search in the hull without any guess."""

    shared: HullProposals

    @property
    def occasion(self) -> Occasion:
        return "search"

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand."""
        shape = self.shared.fits.hand.kinematics.default_shape if state.shape is None else state.shape
        hull = hull_anywhere(self.shared.fits, scene, shape)
        news = shape if state.shape is None else None
        return self.shared.proposed([self.shared.fits.searched(hull, shape, scene.masks)], hull, news)


def nearest_keyframes(keyframes: Sequence[Keyframe], time_s: float) -> list[Anchor]:
    """The nearest in time, nearest first."""
    ordered = sorted(keyframes, key=lambda one: abs(one.time_s - time_s))
    return [anchor_of(one.pose) for one in ordered[:_NEAREST]]


def hull_sources(update: HullUpdate, health: Health) -> tuple[ProposalSource, ...]:
    """All of them in the order in which they are asked."""
    shared = HullProposals(update=update, health=health)
    alternation = (Turns(shared=shared), Fingers(shared=shared)) * _ALTERNATIONS
    return (
        KeyframeHere(shared=shared),
        Refit(shared=shared),
        *alternation,
        Keyframes(shared=shared),
        HullSearch(shared=shared),
    )
