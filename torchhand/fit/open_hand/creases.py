"""Creases: where two parts of a hand meet, its brightness jumps, and the jump tells where a joint is.

Between two neighbouring squares of the grid that show different parts, the boundary is where one of the parts is cut
off, or where their depths cross. The square that it runs through shows both: its brightness is mixed, and moves with
it.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit.open_hand.light import Light
from torchhand.fit.open_hand.pixels import PixelGrid
from torchhand.fit.open_hand.surface import Meeting, dot, meet
from torchhand.hand import FINGERS, PRIMITIVE_NAMES

_BALLS = ("pip", "dip", "ip")
IS_JOINT = torch.tensor([name.rsplit("_", 1)[-1] in _BALLS or name == "thumb_mcp" for name in PRIMITIVE_NAMES])
"""Balls that a cone runs into without a crease."""

_TOUCHING = 0.0015  # metres: surfaces farther apart do not meet; one hides the other
_LEAST_COSINE = 0.3  # between the normals; at sharper edges the jump is no first-order matter
_STRAIGHT = 0.05  # radians between the surfaces on both sides of a joint, below which its ball is a line
_MIXING_STD = 0.15  # of a mixed square's brightness, over the jump: boundaries are no straight lines


@dataclass(frozen=True, kw_only=True)
class Creases:
    """What boundaries do to the squares they run through."""

    correction: Float[Tensor, "squares"]
    """Added to the brightness that the square's own part would have."""
    variance: Float[Tensor, "squares"]
    """Of that."""
    is_unclear: Bool[Tensor, "squares"]
    """Squares at boundaries that no formula here describes: one part hides the other."""
    square: Int[Tensor, "rows"]
    part: Int[Tensor, "rows"]
    slope: Float[Tensor, "rows 18"]
    """Derivative of a square's brightness in the numbers of a part; rows of one square add up."""


def creases(
    grid: PixelGrid,
    numbers: Float[Tensor, "37 18"],
    part: Int[Tensor, "squares"],
    is_used: Bool[Tensor, "squares"],
    light: Light,
) -> Creases:
    """The boundaries between neighbouring used squares of different parts, joints' balls left out."""
    first, second, beside = boundaries(grid, part, is_used)
    near, far = part[first], part[second]
    owner = torch.cat((near, far, near, far, near, far))
    square = torch.cat((first, first, second, second, beside, beside))
    met = meet(numbers, owner, grid.origin[square], grid.direction[square]).split(6)
    here, there = met[:2]
    # The boundary is the zero of one of three functions of the place: positive where the first square's part is seen.
    is_near_cut = here.is_kept() & (met[2].room() < 0)
    is_far_cut = ~is_near_cut & met[3].is_kept() & (there.room() < 0)

    def level(one: Meeting, other: Meeting) -> Tensor:
        by_depth = other.depth - one.depth
        return torch.where(is_near_cut, one.room(), torch.where(is_far_cut, other.room(), by_depth))

    at, beyond, aside = level(here, there), level(met[2], met[3]), level(met[4], met[5])
    apart = torch.minimum((here.depth - there.depth).abs(), (met[2].depth - met[3].depth).abs())
    crosses = (at * beyond < 0) & at.isfinite() & beyond.isfinite() & (apart < _TOUCHING)
    unclear = torch.zeros_like(is_used)
    unclear[first[~crosses]] = True
    unclear[second[~crosses]] = True
    # Each boundary is counted once: along the direction in which it is the steeper.
    is_steep = (beyond - at).abs() >= (aside - at).abs().nan_to_num()
    cosine = dot(here.normal, there.normal)
    keep = (crosses & is_steep & (cosine > _LEAST_COSINE)).nonzero()[:, 0]
    here, there, is_near_cut, is_far_cut = here.select(keep), there.select(keep), is_near_cut[keep], is_far_cut[keep]
    step = (at - beyond)[keep]
    share = at[keep] / step
    jump = light.brightness(here.normal) - light.brightness(there.normal)
    square = torch.where(share < 0.5, first[keep], second[keep])
    zero = torch.zeros_like(grid.value)
    by_depth = ~is_near_cut & ~is_far_cut
    nothing = jump.new_zeros(())
    of_near = torch.where(is_near_cut[:, None], here.room_slope(), nothing)
    of_near = torch.where(by_depth[:, None], -here.depth_slope(), of_near)
    of_far = torch.where(is_far_cut[:, None], there.room_slope(), nothing)
    of_far = torch.where(by_depth[:, None], there.depth_slope(), of_far)
    rate = (jump / step)[:, None]
    return Creases(
        correction=zero.index_add(0, square, (share - 0.5) * jump),
        variance=zero.index_add(0, square, (_MIXING_STD * jump).square()),
        is_unclear=unclear,
        square=torch.cat((square, square)),
        part=torch.cat((near[keep], far[keep])),
        slope=torch.cat((rate * of_near, rate * of_far)),
    )


def boundaries(
    grid: PixelGrid, part: Int[Tensor, "squares"], is_used: Bool[Tensor, "squares"]
) -> tuple[Int[Tensor, "pairs"], Int[Tensor, "pairs"], Int[Tensor, "pairs"]]:
    """Pairs of neighbouring squares of different parts, and the neighbour of the first to the other direction."""
    plain = grid.image(torch.where(is_used & ~IS_JOINT[part.clamp_min(0)], part, -1))
    columns = plain.shape[1]
    found = []
    for here, there, ahead, aside in (
        (plain[:, :-1], plain[:, 1:], 1, columns),
        (plain[:-1], plain[1:], columns, 1),
    ):
        row, column = ((here != there) & (here >= 0) & (there >= 0)).nonzero(as_tuple=True)
        first = row * columns + column
        found.append((first, first + ahead, (first + aside).clamp_max(len(part) - 1)))
    first, second, beside = (torch.cat(both) for both in zip(*found, strict=True))
    return first, second, beside


def _neighbours() -> tuple[Tensor, Tensor]:
    """Of every finger joint's ball, the bones before and after it; -1 of other parts."""
    before, after = (torch.full((len(PRIMITIVE_NAMES),), -1) for _ in range(2))
    for finger in FINGERS:
        bones = ("proximal", "distal") if finger == "thumb" else ("proximal", "middle", "distal")
        balls = ("ip",) if finger == "thumb" else ("pip", "dip")
        for ball, one, other in zip(balls, bones[:-1], bones[1:], strict=True):
            own = PRIMITIVE_NAMES.index(f"{finger}_{ball}")
            before[own] = PRIMITIVE_NAMES.index(f"{finger}_{one}")
            after[own] = PRIMITIVE_NAMES.index(f"{finger}_{other}")
    return before, after


_BEFORE, _AFTER = _neighbours()


def without_flat_joints(
    grid: PixelGrid, numbers: Float[Tensor, "37 18"], part: Int[Tensor, "squares"], is_used: Bool[Tensor, "squares"]
) -> Int[Tensor, "squares"]:
    """The same parts, the balls of straight joints given to the bones beside them: of a ball hardly a line shows."""
    square = (is_used & (_BEFORE[part.clamp_min(0)] >= 0)).nonzero()[:, 0]
    own = part[square]
    one, other = _BEFORE[own], _AFTER[own]
    places = square.repeat(3)
    met = meet(numbers, torch.cat((own, one, other)), grid.origin[places], grid.direction[places])
    seen, first, second = met.split(3)
    is_line = dot(first.normal, second.normal) > 1 - 0.5 * _STRAIGHT**2
    is_first = dot(seen.point, numbers[one, 13:16]) <= numbers[one, 17]
    return part.index_copy(0, square, torch.where(is_line, torch.where(is_first, one, other), own))
