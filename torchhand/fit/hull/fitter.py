"""A skinned hand fitted into visual hulls by least squares: the problem that `solve` is asked, and the verdict on it.

Both sides count: the skin must be inside the hull (all that silhouettes say for certain), and every ray through a
silhouette's edge must touch the skin. Palm and fingers move together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import Explained, Observation, Problem, Schedule, Solutions, solve
from torchhand.fit.hull import coverage, inside
from torchhand.fit.hull.coverage import CoverageObservation
from torchhand.fit.hull.inside import InsideObservation
from torchhand.fit.hull.joint_priors import JointPriors
from torchhand.fit.hull.penetration import PenetrationPrior
from torchhand.fit.hull.settings import SEARCH, HullSettings
from torchhand.fit.hull.skin import SkinPoints
from torchhand.fit.hull.target import HullTarget
from torchhand.fit.hull.vertices import SkinVertices
from torchhand.hand import Hand, HandPose, PoseSpace

MIN_COVERED = 0.85
"""Share of the silhouettes' edges that a hand explains, if it is one and the right one."""
_MIN_NEAR = 0.95  # share of its skin's area that is inside the hull or near it
_AT_ONCE = 32  # hypotheses: bounds the memory


@dataclass(frozen=True, kw_only=True)
class HullFitter:
    """Fits one hand of one shape, in one pose space, into any number of hulls."""

    hand: Hand
    """The hand, in the dtype to compute its skin in."""
    space: PoseSpace
    """Pose space, in the dtype to solve in (float64 is meant); starts are put into it."""
    shape: Float[Tensor, "shape"] | None = None
    """Shape in place of the hand's own."""
    settings: HullSettings = field(default_factory=HullSettings)
    schedule: Schedule = SEARCH
    joints: JointPriors = field(default_factory=JointPriors)

    @cached_property
    def vertices(self) -> SkinVertices:
        """The skin as it is compared with hulls."""
        return SkinVertices.of(SkinPoints(self.hand, self.shape), self.settings)

    def observations(self, target: HullTarget) -> tuple[Observation, ...]:
        """What a hull tells, and what else is known."""
        return (
            InsideObservation(target=target, vertices=self.vertices),
            CoverageObservation(target=target, vertices=self.vertices),
            *target.observations,
        )

    def problem(self, target: HullTarget, *priors: Observation) -> Problem:
        """The problem of poses in a hull. priors: further ones than the joints', such as a prediction."""
        return Problem(
            space=self.space,
            skeleton=self.hand.kinematics.skeleton,
            shape=self.vertices.skin.shape.to(self.space.basis),
            observations=self.observations(target),
            priors=(*self.joints.factors, *self._apart, *priors),
        )

    @property
    def _apart(self) -> tuple[Observation, ...]:
        """Digits not in one another, where that counts."""
        weight = self.joints.weights.penetration
        return (PenetrationPrior(skin=self.vertices.skin, weight=weight),) if weight > 0 else ()

    def __call__(self, target: HullTarget, starts: HandPose, *priors: Observation) -> Solutions:
        """Every hypothesis from its own start, as `solve`."""
        return solve(self.problem(target, *priors), starts, self.schedule, at_once=_AT_ONCE)


@dataclass(frozen=True, kw_only=True)
class HullEvidence:
    """How well fitted hands and the silhouettes explain each other; 0 where there is no hull, or a fit failed."""

    covered: Float[Tensor, "*hypotheses"]
    """Fraction of the silhouettes' edges, or else of the hull's surface, with skin nearby (`HullSettings.near_m`)."""
    near: Float[Tensor, "*hypotheses"]
    """Fraction of the skin's area near the hull or inside."""
    inside: Float[Tensor, "*hypotheses"]
    """Fraction of the skin's area inside the hull (the rate of convergence of Ueda et al. 2003)."""

    @classmethod
    def of(cls, found: Solutions) -> "HullEvidence":
        """Of fitted hands."""
        if not found.explained:
            nothing = torch.zeros_like(found.cost)
            return cls(covered=nothing, near=nothing, inside=nothing)
        return cls.told_by(found.explained, found.is_sound)

    @classmethod
    def told_by(cls, explained: Sequence[Explained], is_sound: Bool[Tensor, "*hypotheses"]) -> "HullEvidence":
        """By what a solution tells of its observations, a row for each hypothesis or frame."""
        skin, edges = (next(one for one in explained if one.name == name) for name in (inside.NAME, coverage.NAME))
        assert skin.inside is not None
        covered, near, within = (
            torch.where(is_sound, fraction.reshape(is_sound.shape), 0.0)
            for fraction in (edges.fraction, skin.fraction, skin.inside)
        )
        return cls(covered=covered, near=near, inside=within)

    @property
    def is_good(self) -> Bool[Tensor, "*hypotheses"]:
        """Whether a hand is there as fitted: False for a hull of something else, for a finger in the wrong place that
        leaves much unexplained, and where the fit failed."""
        return (self.covered >= MIN_COVERED) & (self.near >= _MIN_NEAR)
