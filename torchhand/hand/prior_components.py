"""The postures that the prior mixes: design values in degrees, not measurements (FACTS 8.2 and 2.1 give the ranges)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.skeleton import FINGERS, JOINT_DOFS

Finger = tuple[float, float, float] | tuple[float, float, float, float]
"""MCP flexion, MCP abduction, PIP flexion and, where it is not two thirds of that, DIP flexion; degrees."""
Thumb = tuple[float, float, float, float, float, float]
"""CMC flexion, abduction and twist, MCP flexion and abduction, IP flexion; degrees."""

_STD_DEG = {
    **{"thumb_cmc_fe": 6.0, "thumb_cmc_aa": 6.0, "thumb_cmc_tw": 3.0},
    **{"thumb_mcp_fe": 7.0, "thumb_mcp_aa": 3.0, "thumb_ip_fe": 10.0},
    **{"index_cmc_fe": 1.0, "middle_cmc_fe": 1.0, "ring_cmc_fe": 2.0, "little_cmc_fe": 3.0},
    **{"mcp_fe": 9.0, "mcp_aa": 3.0, "mcp_tw": 1.5, "pip_fe": 11.0, "dip_fe": 10.0},
}
"""Spread of each angle about what the angles before it lead one to expect, for a component of spread 1."""

SLOPES: dict[tuple[str, str], float] = {
    # Fingers that bend take their neighbours along ("enslaving", FACTS 2.1: the middle follows the index by a quarter
    # to a half); fingers that spread do so together; the palm cups as the outer fingers bend.
    ("thumb_ip_fe", "thumb_mcp_fe"): 0.4,
    **{
        (f"{follower}_{joint}_fe", f"{leader}_{joint}_fe"): slope
        for leader, follower, slope in (("index", "middle", 0.5), ("middle", "ring", 0.7), ("ring", "little", 0.7))
        for joint in ("mcp", "pip")
    },
    ("ring_mcp_aa", "index_mcp_aa"): 0.3,
    ("little_mcp_aa", "index_mcp_aa"): 0.5,
    ("ring_cmc_fe", "middle_mcp_fe"): 0.05,
    ("little_cmc_fe", "ring_cmc_fe"): 0.8,
    ("little_cmc_fe", "ring_mcp_fe"): 0.08,
}
"""(angle, earlier angle): by how many degrees the mean of the first moves with each degree of the second."""


@dataclass(frozen=True, kw_only=True)
class PostureComponent:
    """One posture with its share of the mixture, the angles that are expected, and their spread."""

    name: str
    weight: float
    """Relative; above 0."""
    mean: Float[Tensor, "30"]
    """Radians, JOINT_DOFS."""
    std: Float[Tensor, "30"]
    """Radians; of each angle given the ones before it."""

    def __post_init__(self) -> None:
        if not 0 < self.weight < math.inf:
            raise ValueError(f"weight of {self.name}: expected above 0 and finite, got {self.weight!r}")
        if not bool(((self.std > 0) & self.std.isfinite() & self.mean.isfinite()).all()):
            raise ValueError(f"angles of {self.name}: expected finite means and spreads above 0")


def posture_component(
    name: str,
    weight: float,
    *,
    thumb: Thumb,
    index: Finger,
    middle: Finger,
    ring: Finger,
    little: Finger,
    spread: float = 1.0,
    thumb_spread: float = 1.0,
) -> PostureComponent:
    """A component from angles in degrees; the outer metacarpals cup a little with the flexion of their fingers.

    `spread` multiplies the spreads of all angles, `thumb_spread` those of the thumb once more.
    """
    angle = dict(
        zip(("cmc_fe", "cmc_aa", "cmc_tw", "mcp_fe", "mcp_aa", "ip_fe"), thumb, strict=True),
    )
    mean_deg = {f"thumb_{joint}": value for joint, value in angle.items()}
    cup = {"index": (0.5, 0.0), "middle": (0.5, 0.0), "ring": (1.5, 0.05), "little": (2.5, 0.1)}
    for finger, values in zip(FINGERS[1:], (index, middle, ring, little), strict=True):
        mcp, spread_out, pip, *dip = values
        still, bent = cup[finger]
        mean_deg |= {
            f"{finger}_cmc_fe": still + bent * max(mcp, 0.0),
            f"{finger}_mcp_fe": mcp,
            f"{finger}_mcp_aa": spread_out,
            f"{finger}_mcp_tw": 0.0,
            f"{finger}_pip_fe": pip,
            f"{finger}_dip_fe": dip[0] if dip else pip * 2 / 3,
        }
    std_deg = []
    for dof in JOINT_DOFS:
        finger, role = dof.split("_", 1)
        own = _STD_DEG[dof] if dof in _STD_DEG else _STD_DEG[role]
        std_deg.append(own * spread * (thumb_spread if finger == "thumb" else 1.0))
    return PostureComponent(
        name=name,
        weight=weight,
        mean=torch.deg2rad(torch.tensor([mean_deg[dof] for dof in JOINT_DOFS], dtype=torch.float64)),
        std=torch.deg2rad(torch.tensor(std_deg, dtype=torch.float64)),
    )


_AWAY: Thumb = (-8.0, 24.0, 0.0, 4.0, 0.0, 6.0)  # stretched out to the side
_BESIDE: Thumb = (0.0, 6.0, 0.0, 6.0, 0.0, 8.0)  # along the palm's edge
_UP: Thumb = (-12.0, 26.0, 0.0, 0.0, 0.0, -4.0)
_ACROSS: Thumb = (14.0, 10.0, 0.0, 31.0, 0.0, 62.0)  # over the bent fingers
_OVER_RING: Thumb = (30.0, 13.0, 0.0, 39.0, 0.0, 52.0)
# Bent fingers of a fist: a ring finger bent further than its neighbours finds room beside them.
_INDEX: Finger = (80.0, 1.0, 96.0)
_MIDDLE: Finger = (75.0, 1.0, 92.0)
_RING: Finger = (85.0, 4.0, 97.0)
_LITTLE: Finger = (78.0, 5.0, 90.0)


def _straight(spread_out: float = 0.0, mcp: float = 2.0) -> Finger:
    return (mcp, spread_out, 5.0)


COMPONENTS: tuple[PostureComponent, ...] = (
    # the hand by itself
    posture_component(
        *("open", 1.0),
        thumb=_AWAY,
        index=_straight(11, 0),
        middle=_straight(0, 0),
        ring=_straight(7, 0),
        little=_straight(16, 0),
    ),
    posture_component(
        *("flat", 0.8),
        thumb=_BESIDE,
        index=_straight(),
        middle=_straight(),
        ring=_straight(1),
        little=_straight(3),
        spread=0.8,
    ),
    posture_component(
        *("relaxed", 1.8),
        thumb=(2, 22, 0, 12, 0, 18),
        index=(18, 3, 24),
        middle=(24, 0, 30),
        ring=(27, 2, 33),
        little=(26, 6, 32),
    ),
    posture_component(
        *("half_closed", 1.2),
        thumb=(8, 26, 0, 16, 0, 24),
        index=(36, 2, 44),
        middle=(42, 0, 50),
        ring=(46, 2, 52),
        little=(46, 4, 48),
    ),
    posture_component(
        *("fist", 1.6), thumb=_ACROSS, index=_INDEX, middle=_MIDDLE, ring=_RING, little=_LITTLE, spread=0.45
    ),
    posture_component(
        *("hook", 0.8),
        thumb=_BESIDE,
        index=(8, 2, 82, 52),
        middle=(10, 0, 86, 55),
        ring=(10, 2, 86, 55),
        little=(8, 4, 80, 52),
        spread=0.8,
    ),
    posture_component(
        *("table_top", 0.6),
        thumb=(4, 16, 0, 8, 0, 10),
        index=(66, 0, 10),
        middle=(70, 0, 10),
        ring=(70, 1, 10),
        little=(66, 2, 12),
        spread=0.7,
    ),
    # gestures
    posture_component(
        *("point", 0.9), thumb=_ACROSS, index=_straight(), middle=_MIDDLE, ring=_RING, little=_LITTLE, spread=0.5
    ),
    posture_component(
        *("thumb_up", 0.6), thumb=_UP, index=_INDEX, middle=_MIDDLE, ring=_RING, little=_LITTLE, spread=0.5
    ),
    posture_component(
        *("gun", 0.5), thumb=_UP, index=_straight(), middle=_MIDDLE, ring=_RING, little=_LITTLE, spread=0.5
    ),
    posture_component(
        # as far as equation (3) lets it: the ring finger's knuckle 40° beyond the middle finger's
        *("victory", 0.7),
        thumb=_OVER_RING,
        index=_straight(10, 4),
        middle=(24, -3, 7),
        ring=(64, 3, 91),
        little=(71, 4, 91),
        spread=0.5,
    ),
    posture_component(
        *("three", 0.4),
        thumb=(34, 24, 0, 44, 0, 46),
        index=_straight(9),
        middle=_straight(),
        ring=_straight(6, 6),
        little=(62, 0, 80),
        spread=0.6,
    ),
    posture_component(
        *("four", 0.4),
        thumb=(28, 16, 0, 40, 0, 45),
        index=_straight(8),
        middle=_straight(),
        ring=_straight(6),
        little=_straight(14),
        spread=0.6,
    ),
    posture_component(
        *("shaka", 0.4), thumb=_UP, index=_INDEX, middle=_MIDDLE, ring=_RING, little=_straight(16, 4), spread=0.5
    ),
    # small things between the thumb and fingertips
    posture_component(
        *("pinch_index", 1.0),
        thumb=(16, 20, -4, 28, -5, 28),
        index=(51, 0, 53),
        middle=(50, 0, 55),
        ring=(54, 2, 58),
        little=(54, 4, 55),
        spread=0.4,
    ),
    posture_component(
        *("ring_shape", 0.7),
        thumb=(16, 20, -4, 28, -5, 28),
        index=(48, 2, 55),
        middle=(25, 0, 14),
        ring=(11, 4, 9),
        little=(5, 10, 7),
        spread=0.4,
    ),
    posture_component(
        *("pinch_middle", 0.6),
        thumb=(25, 22, -4, 30, -5, 29),
        index=(30, 3, 30),
        middle=(54, 1, 53),
        ring=(56, 2, 53),
        little=(45, 5, 45),
        spread=0.4,
    ),
    posture_component(
        *("pinch_ring", 0.4),
        thumb=(30, 28, -2, 35, -2, 32),
        index=(25, 3, 25),
        middle=(35, 0, 38),
        ring=(60, 0, 53),
        little=(50, 5, 50),
        spread=0.4,
    ),
    posture_component(
        *("pinch_little", 0.4),
        thumb=(32, 28, -4, 42, -3, 42),
        index=(18, 3, 18),
        middle=(22, 0, 25),
        ring=(40, 0, 40),
        little=(62, 0, 51),
        spread=0.4,
    ),
    posture_component(
        *("tripod", 1.0),
        thumb=(21, 23, -4, 29, -5, 29),
        index=(55, 0, 50),
        middle=(56, 0, 53),
        ring=(59, 2, 62),
        little=(58, 4, 60),
        spread=0.4,
    ),
    posture_component(
        *("flat_pinch", 0.6),
        thumb=(28, 29, -6, 25, -7, 17),
        index=(68, 0, 27),
        middle=(67, 0, 29),
        ring=(70, 1, 27),
        little=(66, 2, 29),
        spread=0.4,
    ),
    posture_component(
        *("key", 0.8),
        thumb=(7, 7, 0, 21, 0, 22),
        index=(54, 0, 70),
        middle=(56, 0, 71),
        ring=(63, 2, 76),
        little=(61, 4, 72),
        spread=0.45,
    ),
    # things in the whole hand
    posture_component(
        *("small_cylinder", 1.0),
        thumb=(20, 30, 0, 26, 0, 36),
        index=(58, 1, 62),
        middle=(60, 0, 66),
        ring=(64, 2, 66),
        little=(62, 4, 62),
        spread=0.6,
    ),
    posture_component(
        *("large_cylinder", 1.0),
        thumb=(15, 31, 0, 14, 0, 20),
        index=(30, 4, 38),
        middle=(34, 0, 40),
        ring=(36, 3, 40),
        little=(36, 6, 38),
        spread=0.7,
    ),
    posture_component(
        *("ball", 0.8),
        thumb=(14, 33, 0, 14, 0, 22),
        index=(28, 11, 36),
        middle=(30, 0, 40),
        ring=(30, 7, 38),
        little=(30, 15, 36),
        spread=0.7,
    ),
    posture_component(
        *("plate", 0.6),
        thumb=(18, 28, 0, 8, 0, 8),
        index=(46, 3, 12),
        middle=(50, 0, 14),
        ring=(52, 2, 14),
        little=(50, 5, 14),
        spread=0.7,
    ),
)
