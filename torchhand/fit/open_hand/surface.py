"""The primitives of a hand along the rays of pixels, with derivatives: where a ray meets a part, and how that moves.

Every primitive is a quadric Xᵀ A X + 2 bᵀ X + c = 0 (negative inside), kept where low <= axis · X <= high. Its 18
numbers stand in one row, and every derivative here is one in these numbers; what unknowns do to them is found once for
a hand.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.hand import Primitives

NUMBERS = 18
"""A row by row (9), b (3), c, axis (3), low, high; the camera's frame."""

_CORNER, _AXIS, _LOW, _HIGH = 12, slice(13, 16), 16, 17
_FAR = 1e3  # metres: stands for a part that is not cut off at this end


def quadric_numbers(primitives: Primitives) -> Float[Tensor, "37 18 hands"]:
    """The numbers of every part, for primitives in the camera's frame; one batch dimension or none: it comes last."""
    parts = primitives.implicit()
    ends = (parts.low.nan_to_num(neginf=-_FAR), parts.high.nan_to_num(posinf=_FAR))
    scalars = (parts.corner, *ends)
    corner, low, high = (scalar[:, None] for scalar in scalars)
    return torch.cat((parts.upper.flatten(1, 2), parts.edge, corner, parts.axis, low, high), 1)


def dot(first: Float[Tensor, "rays 3"], second: Float[Tensor, "rays 3"]) -> Float[Tensor, "rays"]:
    """Of every row: several times as fast as to sum so short ones."""
    found = first[:, 0] * second[:, 0]
    return found.addcmul_(first[:, 1], second[:, 1]).addcmul_(first[:, 2], second[:, 2])


@dataclass(frozen=True, kw_only=True)
class Meeting:
    """Where rays first meet the quadrics of given parts, whether cut off there or not; NaN where they pass by."""

    numbers: Float[Tensor, "rays 18"]
    """Of the ray's part."""
    direction: Float[Tensor, "rays 3"]
    """z = 1"""
    depth: Float[Tensor, "rays"]
    """z in the camera's frame, metres."""
    point: Float[Tensor, "rays 3"]
    gradient: Float[Tensor, "rays 3"]
    """A X + b, outward."""
    turned: Float[Tensor, "rays 3"]
    """A · direction"""

    def select(self, rows: Bool[Tensor, "rays"] | Int[Tensor, "kept"]) -> "Meeting":
        return Meeting(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def split(self, parts: int) -> "list[Meeting]":
        """The rays in so many equal lots."""
        lots = [getattr(self, field.name).chunk(parts) for field in fields(self)]
        return [Meeting(**dict(zip(_FIELDS, lot, strict=True))) for lot in zip(*lots, strict=True)]

    @cached_property
    def normal(self) -> Float[Tensor, "rays 3"]:
        return self.gradient / self.gradient.norm(dim=-1, keepdim=True)

    def depth_slope(self) -> Float[Tensor, "rays 18"]:
        """Derivative of the depth: a change δf of the quadric's value there moves it by -δf / (2 D · gradient)."""
        return (-0.5 / dot(self.direction, self.gradient))[:, None] * self._value_slope()

    def gradient_slope(self, weight: Float[Tensor, "rays 3"]) -> Float[Tensor, "rays 18"]:
        """Derivative of weight · gradient."""
        direct = torch.zeros_like(self.numbers)
        direct[:, :9] = (weight[:, :, None] * self.point[:, None, :]).flatten(1)
        direct[:, 9:_CORNER] = weight
        return direct + dot(weight, self.turned)[:, None] * self.depth_slope()

    def room(self) -> Float[Tensor, "rays"]:
        """Distance to the nearer of the part's two ends along its axis, metres; negative where it is cut off."""
        return self._end * (self._limit() - self._level)

    def room_slope(self) -> Float[Tensor, "rays 18"]:
        end, axis = self._end, self.numbers[:, _AXIS]
        direct = torch.zeros_like(self.numbers)
        direct[:, _AXIS] = -end[:, None] * self.point
        direct[:, _LOW] = torch.where(end < 0, -1.0, 0.0)
        direct[:, _HIGH] = torch.where(end > 0, 1.0, 0.0)
        return direct - (end * dot(axis, self.direction))[:, None] * self.depth_slope()

    def is_kept(self) -> Bool[Tensor, "rays"]:
        """Whether there is such a point and the part is not cut off there."""
        return self.room() >= 0

    def _value_slope(self) -> Tensor:
        slope = torch.zeros_like(self.numbers)
        slope[:, :9] = (self.point[:, :, None] * self.point[:, None, :]).flatten(1)
        slope[:, 9:_CORNER] = 2 * self.point
        slope[:, _CORNER] = 1.0
        return slope

    @cached_property
    def _level(self) -> Tensor:
        return dot(self.numbers[:, _AXIS], self.point)

    @cached_property
    def _end(self) -> Tensor:
        """+1 where the upper end is the nearer one, -1 where the lower."""
        level = self._level
        is_upper = (level - self.numbers[:, _HIGH]).abs() < (level - self.numbers[:, _LOW]).abs()
        return torch.where(is_upper, 1.0, -1.0).to(level)

    def _limit(self) -> Tensor:
        return torch.where(self._end > 0, self.numbers[:, _HIGH], self.numbers[:, _LOW])


_FIELDS = tuple(field.name for field in fields(Meeting))


def meet(
    numbers: Float[Tensor, "37 18"],
    part: Int[Tensor, "rays"],
    origin: Float[Tensor, "rays 3"],
    direction: Float[Tensor, "rays 3"],
) -> Meeting:
    """The rays at the parts that `part` numbers; no derivative flows."""
    own = numbers.index_select(0, part)
    upper, edge = own[:, :9].unflatten(-1, (3, 3)), own[:, 9:_CORNER]
    turned = (upper @ direction[..., None]).squeeze(-1)
    base = (upper @ origin[..., None]).squeeze(-1) + edge
    quadratic, linear = dot(turned, direction), dot(base, direction)
    constant = dot(base + edge, origin) + own[:, _CORNER]
    power = linear.square() - quadratic * constant
    depth = (-linear - power.clamp_min(0).sqrt()) / quadratic
    depth = torch.where((power > 0) & (quadratic > 0) & (depth > 0), depth, torch.nan)
    return Meeting(
        numbers=own,
        direction=direction,
        depth=depth,
        point=origin + depth[:, None] * direction,
        gradient=base + depth[:, None] * turned,
        turned=turned,
    )
