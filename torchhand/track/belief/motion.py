"""How a followed hand moves between two frames, and how it begins: prediction, spreads, limits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import free_bounds
from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import HandPose, PoseSpace, Skeleton
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import Gaussian, MotionModel, mode_in_box, predict_linear
from torchhand.numerics.filters import with_marginal
from torchhand.track.belief.settings import NoiseSettings
from torchhand.track.belief.state import FollowedHand

Kind = Literal["translation", "rotation", "angle"]

_START_STD = {"translation": 0.003, "rotation": 0.03, "angle": 0.08}  # m, rad, rad
_START_SPEED = {"translation": 0.2, "rotation": 1.0, "angle": 1.0}  # per second
_START_ACCELERATION = {"translation": 2.0, "rotation": 10.0, "angle": 10.0}  # per second squared
_CLOCK_S = 1e-9  # time stamps are compared to this


def kind_of(name: str) -> Kind:
    """What a DOF is: translation or rotation of the root, or a joint angle."""
    if name.startswith("root_t"):
        return "translation"
    return "rotation" if name.startswith("root_r") else "angle"


@dataclass(frozen=True, kw_only=True)
class _About:
    """What depends on the pose that the free parameters of a track are changes from."""

    space: PoseSpace
    lower: Float[Tensor, "state"]
    """Lower bounds of the parameters and of their rates, which have none."""
    upper: Float[Tensor, "state"]


@dataclass(frozen=True, kw_only=True)
class HandMotion:
    """The dynamics of one hand in a pose space, within its joint limits.

    A free angle stops at its own limit, and its rates with it; what is correlated with it follows (`mode_in_box`). An
    angle that is tied to it may stop before: it does so in the pose alone, and the free one goes on.
    """

    space: PoseSpace
    skeleton: Skeleton
    model: MotionModel
    noise: NoiseSettings

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        """Kinds of the free parameters."""
        return tuple(kind_of(name) for name in self.space.free_names)

    @cached_property
    def density(self) -> Float[Tensor, "free"]:
        """Nominal spectral density of the process noise."""
        root = {"translation": self.noise.translation, "rotation": self.noise.rotation, "angle": self.noise.angle}
        return self._told([root[kind] ** 2 for kind in self.kinds])

    @cached_property
    def spread(self) -> Float[Tensor, "state"]:
        """Variances of a state of which nothing but a rough pose is known: parameters, then their rates."""
        tables = (_START_STD, _START_SPEED, _START_ACCELERATION)[: self.model.order + 1]
        return torch.cat([self._told([t[kind] for kind in self.kinds]) ** 2 for t in tables])

    @cached_property
    def _is_rotation(self) -> Tensor:
        return torch.tensor([kind == "rotation" for kind in self.kinds], device=self.space.basis.device)

    def _told(self, values: Sequence[float]) -> Float[Tensor, "n"]:
        return torch.tensor(values, dtype=torch.float64, device=self.space.basis.device)

    @cached_property
    def _last_about(self) -> "list[tuple[Tensor, _About]]":
        return []

    def _about(self, base: Float[Tensor, "36"]) -> "_About":
        """Space and bounds of a track, whose hands have one base: made once for it."""
        kept = self._last_about
        if not kept or kept[0][0] is not base:
            kept[:] = [(base, self._made_about(base))]
        return kept[0][1]

    def _made_about(self, base: Float[Tensor, "36"]) -> "_About":
        space = self.space.about(base)
        rates = (0, len(self.spread) - space.size)
        lower, upper = free_bounds(space, self.skeleton)
        pad = torch.nn.functional.pad
        return _About(space=space, lower=pad(lower, rates, value=-torch.inf), upper=pad(upper, rates, value=torch.inf))

    def process_noise(self, dt_s: float, density: Float[Tensor, "free"] | None = None) -> Float[Tensor, "n n"]:
        """Covariance that a time step adds; the nominal density where none is given."""
        return self.model.process_noise(_rounded(dt_s), self.density if density is None else density)

    def predicted(self, hand: FollowedHand, dt_s: float) -> FollowedHand:
        """The hand a time step later, nothing being seen."""
        transition = self.model.transition(_rounded(dt_s), self.space.size, device=self.space.basis.device)
        return replace(
            hand,
            belief=predict_linear(hand.belief, transition, self.process_noise(dt_s, hand.density)),
            dt_s=_rounded(dt_s),
            frames=hand.frames + 1,
        )

    def pose(self, hand: FollowedHand) -> HandPose:
        """What a hand is believed to be, within the limits; its rotation vector is about the hand's reference."""
        wanted = self._about(hand.base).space.dof(hand.belief.mean[: self.space.size])
        return HandPose(dofs=clamp_to_limits(wanted, self.skeleton), reference=hand.reference)

    def prior(self, hand: FollowedHand) -> Gaussian:
        """The belief of the free parameters alone, without their rates."""
        count = self.space.size
        return Gaussian(hand.belief.mean[:count], hand.belief.covariance[:count, :count])

    def limited(self, hand: FollowedHand) -> FollowedHand:
        """Joint limits kept; the root's rotation moved from the belief's mean into the reference."""
        count, belief = self.space.size, hand.belief
        about = self._about(hand.base)
        mean, is_bound = mode_in_box(belief, about.lower, about.upper)
        blocks = mean.reshape(-1, count).clone()
        blocks[1:] = torch.where(is_bound[:count], 0.0, blocks[1:])
        kept = replace(hand, belief=Gaussian(blocks.flatten(), belief.covariance))
        turned = rotation_from_vector(self.pose(kept).dofs[3:6])
        blocks[0] = torch.where(self._is_rotation, 0.0, blocks[0])
        return replace(hand, belief=Gaussian(blocks.flatten(), belief.covariance), reference=turned @ hand.reference)

    def started(self, pose: HandPose, base: Float[Tensor, "36"] | None = None) -> FollowedHand:
        """A hand of which a rough pose is known. base: that free parameters are changes from; the pose where it is
        None."""
        at = pose.normalized()
        base = at.dofs if base is None else base
        free = self.space.about(base).own(at.dofs)
        return FollowedHand(
            belief=self.at_rest(free, None), base=base, reference=at.reference, start_reference=at.reference
        )

    def at_rest(self, free: Float[Tensor, "free"], covariance: Float[Tensor, "free free"] | None) -> Gaussian:
        """A belief of a pose, with rates of which nothing is known."""
        whole = self.spread.diag_embed()
        if covariance is not None and bool(covariance.isfinite().all()):
            whole[: len(free), : len(free)] = covariance
        return Gaussian(torch.cat((free, free.new_zeros(len(self.spread) - len(free)))), whole)

    def free_of(self, hand: FollowedHand, pose: HandPose) -> Float[Tensor, "free"]:
        """A pose in the parameters of a hand's belief."""
        turn = vector_from_rotation(pose.rotation @ hand.reference.mT)
        dofs = torch.cat((pose.dofs[:3], turn, pose.dofs[6:]))
        return self._about(hand.base).space.own(dofs)

    def put(self, hand: FollowedHand, pose: HandPose, is_put: Bool[Tensor, "free"]) -> FollowedHand:
        """A hand with some of its parameters as a pose has them, because what was believed of them is no longer
        credible (a manoeuvre): they are as uncertain as they moved."""
        count = self.space.size
        missed = torch.where(is_put, self.free_of(hand, pose) - hand.belief.mean[:count], 0.0)
        mean, covariance = hand.belief.mean.clone(), hand.belief.covariance.clone()
        mean[:count] += missed
        covariance.diagonal()[:count] += missed.square()
        return replace(hand, belief=Gaussian(mean, covariance))

    def begun(self, hand: FollowedHand, pose: HandPose, covariance: Float[Tensor, "free free"]) -> FollowedHand:
        """The hand at a fitted pose, its rates forgotten."""
        belief = self.at_rest(self.free_of(hand, pose), covariance)
        return self.limited(replace(hand, belief=belief, density=None))

    def corrected(self, hand: FollowedHand, pose: HandPose, covariance: Float[Tensor, "free free"]) -> FollowedHand:
        """A prediction corrected by a fit whose prior it was (Jeffrey's rule: the rates follow)."""
        belief = with_marginal(hand.belief, self.free_of(hand, pose), covariance)
        return self.limited(replace(hand, belief=belief))


def _rounded(dt_s: float) -> float:
    """Equal frame distances stay equal."""
    return round(dt_s / _CLOCK_S) * _CLOCK_S
