"""Proposals: other hands that may explain a scene, tried in their order while the followed one is degraded."""

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, get_args, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Appearance
from torchhand.fit.detect import CutAtKeypoints, Start
from torchhand.hand import HandPose
from torchhand.track.knowledge import TrackerState
from torchhand.track.scene import Candidate, Scene


@dataclass(frozen=True, kw_only=True)
class Proposed:
    """A hand that may be the one in the pictures."""

    pose: HandPose
    covariance: Float[Tensor, "free free"] | None = None
    """Covariance of the free parameters, where it is known."""
    candidate: Candidate | None = None
    """The proposal as its update rule evaluates it, where the proposal has done so already."""
    shape: Float[Tensor, "shape"] | None = None
    """Proportions that were fitted together with the pose; None where the known ones were used."""
    appearance: Appearance | CutAtKeypoints | None = None
    """Appearance of the hand, where that was learned with it."""

    @classmethod
    def of_start(cls, start: Start) -> "Proposed":
        """A first hand, with its proportions and its appearance."""
        pose = HandPose.of(start.fit.pose, start.fit.root_reference)
        return cls(pose=pose, shape=start.fit.shape, appearance=start.appearance)


@dataclass(frozen=True, kw_only=True)
class Proposals:
    """What one source proposes."""

    hands: tuple[Proposed, ...] = ()
    reason: str = ""
    """Why no hand is proposed."""
    has_foreground: bool = False
    """Whether the scene shows something that may be a hand."""


Occasion = Literal["always", "detected", "declining", "degraded", "search", "patient"]
"""When a source is asked: at every frame; where the hand is degraded and a detector tells of one, which takes no longer
than a frame; where it explains less than it did at best; where it is degraded; where it is degraded and a search is
due; where it is degraded and pictures wait for as long as it takes, as those of a recording do."""

OCCASIONS: tuple[Occasion, ...] = get_args(Occasion)


@runtime_checkable
class ProposalSource(Protocol):
    """Proposes hands for a scene."""

    occasion: ClassVar[Occasion]
    """When it is asked."""

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """best: the best hand so far; None where there is none."""
        ...
