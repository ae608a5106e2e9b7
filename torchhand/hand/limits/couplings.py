"""How joint angles bind each other: equations (1) to (5) of Ouhaddi and Horain (1998).

Flexion is positive throughout, unlike in the paper's limits.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.kinematics import FINGERS, JOINT_DOFS

FLEXIONS = tuple(JOINT_DOFS.index(f"{finger}_mcp_fe") for finger in FINGERS[1:])
"""MCP flexions of index, middle, ring, little: the angles that the bands bind; index into JOINT_DOFS."""
ABDUCTIONS = tuple(JOINT_DOFS.index(f"{finger}_mcp_aa") for finger in FINGERS[1:])

_OPEN = math.inf
NEIGHBOUR_BANDS_DEG: dict[str, tuple[tuple[float, float], ...]] = {
    # (lower, upper) of index − middle, middle − ring, ring − little
    "paper": ((-_OPEN, 25.0), (-45.0, _OPEN), (-_OPEN, _OPEN)),  # equation (3)
    "neighbours": ((-54.0, 25.0), (-45.0, 20.0), (-44.0, 48.0)),  # the full table after Lee and Kunii 1995
    "none": ((-_OPEN, _OPEN),) * 3,
}
"""Bands on the differences of neighbouring MCP flexions, degrees."""


@dataclass(frozen=True, kw_only=True)
class Tie:
    """An angle that follows another: target = factor · source + offset, as far as the target's limits let it."""

    equation: int
    """Number of the equation in Ouhaddi and Horain (1998)."""
    source: int
    """Index of the source into JOINT_DOFS."""
    target: int
    """Index of the target into JOINT_DOFS."""
    factor: float
    offset: float = 0.0
    """Offset of the target, radians."""

    @property
    def name(self) -> str:
        shift = f" − {-math.degrees(self.offset):.0f}°" if self.offset else ""
        return f"eq. {self.equation}: {JOINT_DOFS[self.target]} = {self.factor:.3g} {JOINT_DOFS[self.source]}{shift}"


def _tie(equation: int, source: str, target: str, factor: float, offset: float = 0.0) -> Tie:
    return Tie(
        equation=equation,
        source=JOINT_DOFS.index(source),
        target=JOINT_DOFS.index(target),
        factor=factor,
        offset=offset,
    )


TIES = (
    *(_tie(1, f"{finger}_pip_fe", f"{finger}_dip_fe", 2 / 3) for finger in FINGERS[1:]),
    _tie(4, "thumb_cmc_fe", "thumb_mcp_fe", 2.0, -math.pi / 3),
    _tie(5, "thumb_cmc_aa", "thumb_mcp_aa", 7 / 5),
)
"""Equations (1), (4) and (5)."""


def band_rows(bands: str) -> tuple[tuple[str, ...], Float[Tensor, "rows 4"], Float[Tensor, "rows"]]:
    """The bands as inequalities matrix · (MCP flexions index to little) <= bound, with a name for each; radians."""
    names, rows, bounds = [], [], []
    for first, (lower, upper) in enumerate(NEIGHBOUR_BANDS_DEG[bands]):
        one, other = (f"{FINGERS[1 + first + i]}_mcp_fe" for i in (0, 1))
        for sign, limit, text in ((1.0, upper, f"{one} <= {other}"), (-1.0, -lower, f"{other} <= {one}")):
            if math.isfinite(limit):
                row = torch.zeros(4, dtype=torch.float64)
                row[first], row[first + 1] = sign, -sign
                names.append(f"eq. 3: {text} + {limit:.0f}°")
                rows.append(row)
                bounds.append(math.radians(limit))
    matrix = torch.stack(rows) if rows else torch.zeros(0, 4, dtype=torch.float64)
    return tuple(names), matrix, torch.tensor(bounds, dtype=torch.float64)


def abduction_room(flexion: Float[Tensor, "*sizes"], vanishes_at: float) -> Float[Tensor, "*sizes"]:
    """Share of the abduction's limits left at a flexion: equation (2), 1 − clamp(θ_fe, 0, θ_max) / θ_max; radians."""
    return 1 - flexion.clamp(0.0, vanishes_at) / vanishes_at


def nearest_on_tie(
    source: Float[Tensor, "*sizes"],
    target: Float[Tensor, "*sizes"],
    tie: Tie,
    source_limits: tuple[float, float],
    target_limits: tuple[float, float],
) -> tuple[Float[Tensor, "*sizes"], Float[Tensor, "*sizes"]]:
    """The nearest pair of angles on target = clamp(factor · source + offset, limits), source within its own.

    The curve is a slope between two level pieces; the nearest point is that of the nearest piece.
    """
    low, high = ((limit - tie.offset) / tie.factor for limit in target_limits)  # where the slope begins and ends
    ends = [(source_limits[0], low), (low, high), (high, source_limits[1])]
    along = (source + tie.factor * (target - tie.offset)) / (1 + tie.factor**2)
    pieces = []
    for (start, stop), place in zip(ends, (source, along, source), strict=True):
        start, stop = (min(max(end, source_limits[0]), source_limits[1]) for end in (start, stop))
        pieces.append(place.clamp(start, stop))
    places = torch.stack(pieces)
    heights = (tie.factor * places + tie.offset).clamp(*target_limits)
    distance = (places - source).square() + (heights - target).square()
    best = distance.detach().argmin(0, keepdim=True)
    return places.gather(0, best)[0], heights.gather(0, best)[0]
