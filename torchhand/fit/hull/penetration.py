"""Digits that may not be in one another, as a prior: two fingers fill one finger's part of a hull as well as one does.

The depths are those of `torchhand.hand.penetration` between the segments of different digits, in which skin and pads
give by a few millimetres. Their derivative is exact, the places at which two capsules are deepest in each other held.
"""

from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor, is_host
from torchhand.fit import Equations, OwnFactor, PosedHands
from torchhand.fit.hull.skin import PosedBones, SkinPoints, bones_of
from torchhand.geometry import tapered_capsule_touch
from torchhand.hand import CONE_BONES, DOFS, PenetrationSettings, digit_pairs, primitive_sizes
from torchhand.volume import places_of

_ROOT = 6
_GROSS = 3.0  # depths in units of the softness beyond which more counts for less (Cauchy): digits must get past others
_NOTHING = 1e-9  # metres: keeps directions finite where two axes meet


@dataclass(frozen=True, kw_only=True)
class PenetrationPrior(OwnFactor):
    """½ weight Σ (excess / softness)² over the pairs of segments, deep ones less."""

    skin: SkinPoints
    """Tells the bones, in the dtype to compute in."""
    weight: float = 1.0
    settings: PenetrationSettings = field(default_factory=PenetrationSettings)

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the joint angles; the dependence on the shape is left out."""
        skin = self.skin.for_shape(hands)
        bones = bones_of(skin, hands)
        start, end, radii = _capsules(skin, hands, bones)
        _, first, second, slack = digit_pairs(self.settings, start.device)
        if is_host(start.device):  # few pairs are near each other, and fewer in one another
            near = places_of(_may_meet(start, end, radii, first, second, slack))
            if not len(near):
                return _nothing(start)
            first, second, slack = first[near], second[near], slack[near]
        s, t = tapered_capsule_touch(
            start[:, first], end[:, first], radii[first], start[:, second], end[:, second], radii[second]
        )
        here = torch.lerp(start[:, first], end[:, first], s[..., None])
        there = torch.lerp(start[:, second], end[:, second], t[..., None])
        reach = torch.lerp(radii[first, 0], radii[first, 1], s) + torch.lerp(radii[second, 0], radii[second, 1], t)
        apart = here - there
        distance = apart.norm(dim=-1).clamp_min(_NOTHING)
        excess = (reach - distance - slack.to(reach)).clamp_min(0)
        direction = apart / distance[..., None]
        if is_host(start.device):
            met = places_of((excess != 0).any(0))
            if not len(met):
                return _nothing(start)
            first, second, excess = first[met], second[met], excess[:, met]
            here, there, direction = here[:, met], there[:, met], direction[:, met]
        own = constant_tensor(CONE_BONES[1:], torch.long, start.device)
        pull = _turned(skin, bones, (here, own[first]), (there, own[second]), direction)
        residual, rows = excess / self.settings.softness, pull / self.settings.softness
        square = (residual / _GROSS).square()
        trust = (excess > 0) / (1 + square)
        cost = 0.5 * self.weight * _GROSS**2 * square.log1p().sum(-1)
        return Equations.of_rows(residual, self.weight * trust, rows, cost, first_dof=_ROOT)


def _capsules(skin: SkinPoints, hands: PosedHands, bones: PosedBones) -> tuple[Tensor, Tensor, Tensor]:
    """Both ends (hands, segments, 3) of the digits' segments, and the radii there (segments, 2)."""
    space, shape = skin.hand.kinematics.shape_space, skin.shape
    sizes = hands.once_for_shape(("primitive sizes", id(skin)), lambda: primitive_sizes(space, shape))
    own = constant_tensor(CONE_BONES[1:], torch.long, shape.device)
    start = bones.position.index_select(1, own)
    end = start + bones.rotation.index_select(1, own)[..., 1] * sizes.cone_length[1:, None]
    radius = sizes.cone_start[1:, 0]
    return start, end, torch.stack((radius, radius * sizes.cone_end_scale[1:]), -1)


def _nothing(start: Float[Tensor, "hands segments 3"]) -> Equations:
    """Equations where no digit is in another."""
    hands, angles = len(start), len(DOFS) - _ROOT
    return Equations(
        cost=start.new_zeros(hands),
        gradient=start.new_zeros(hands, angles),
        matrix=start.new_zeros(hands, angles, angles),
        first_dof=_ROOT,
    )


def _may_meet(
    start: Float[Tensor, "hands segments 3"],
    end: Float[Tensor, "hands segments 3"],
    radii: Float[Tensor, "segments 2"],
    first: Int[Tensor, "pairs"],
    second: Int[Tensor, "pairs"],
    slack: Float[Tensor, "pairs"],
) -> Bool[Tensor, "pairs"]:
    """Which pairs of segments may be in each other by more than the slack, in any of the hands or one that is no hand:
    all but those that a plane across the line between their middles parts."""
    middle, half, radius = 0.5 * (start + end), 0.5 * (end - start), radii.amax(-1)
    between = middle[:, second] - middle[:, first]
    distance = between.norm(dim=-1)
    along = ((half[:, first] * between).sum(-1).abs() + (half[:, second] * between).sum(-1).abs()) / distance
    return ~(distance - along > radius[first] + radius[second] - slack.to(radius)).all(0)


def _turned(
    skin: SkinPoints,
    bones: PosedBones,
    one: tuple[Float[Tensor, "hands m 3"], Int[Tensor, "m"]],
    other: tuple[Float[Tensor, "hands m 3"], Int[Tensor, "m"]],
    direction: Float[Tensor, "hands m 3"],
) -> Float[Tensor, "hands m angles"]:
    """Derivative of direction · (other - one) in the joint angles, both points on bones that carry them."""
    (here, on), (there, other_on) = one, other
    carries = skin.carries[skin.bones_turned].to(here)  # angles bones
    near, far = carries[:, on].T[..., None], carries[:, other_on].T[..., None]  # m angles 1
    origin = bones.position.index_select(1, skin.bones_turned)[:, None]  # hands 1 angles 3
    lever = far * (there[:, :, None] - origin) - near * (here[:, :, None] - origin)
    # direction · (axis × lever), for all angles
    turned = torch.linalg.cross(direction[:, :, None].expand_as(lever), bones.turns[:, None, 3:].expand_as(lever))
    return (turned * lever).sum(-1)
