"""One posture of the prior's mixture: expected angles and their spread, and how angles follow one another."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.kinematics import FINGERS, JOINT_DOFS

Degrees = int | float
Finger = tuple[Degrees, Degrees, Degrees] | tuple[Degrees, Degrees, Degrees, Degrees]
"""MCP flexion, MCP abduction, PIP flexion and, where it is not two thirds of that, DIP flexion; degrees."""
Thumb = tuple[Degrees, Degrees, Degrees, Degrees, Degrees, Degrees]
"""CMC flexion, abduction and twist, MCP flexion and abduction, IP flexion; degrees."""

_STD_DEG = {
    **{"thumb_cmc_fe": 6.0, "thumb_cmc_aa": 6.0, "thumb_cmc_tw": 3.0},
    **{"thumb_mcp_fe": 7.0, "thumb_mcp_aa": 3.0, "thumb_ip_fe": 10.0},
    **{"index_cmc_fe": 1.0, "middle_cmc_fe": 1.0, "ring_cmc_fe": 2.0, "little_cmc_fe": 3.0},
    **{"mcp_fe": 9.0, "mcp_aa": 4.0, "mcp_tw": 1.5, "pip_fe": 11.0, "dip_fe": 10.0},
}
"""Spread of each angle about what the angles before it lead one to expect, for a component of spread 1."""

SLOPES: dict[tuple[str, str], float] = {
    # Fingers that bend take their neighbours along ("enslaving": the middle follows the index by a quarter
    # to a half); fingers that spread do so together; the palm cups as the outer fingers bend.
    ("thumb_ip_fe", "thumb_mcp_fe"): 0.4,
    **{
        (f"{follower}_{joint}_fe", f"{leader}_{joint}_fe"): slope
        for leader, follower, slope in (("index", "middle", 0.6), ("middle", "ring", 0.7), ("ring", "little", 0.7))
        for joint in ("mcp", "pip")
    },
    ("ring_mcp_aa", "index_mcp_aa"): 0.3,
    ("little_mcp_aa", "index_mcp_aa"): 0.5,
    ("ring_cmc_fe", "middle_mcp_fe"): 0.03,
    ("little_cmc_fe", "ring_cmc_fe"): 0.8,
    ("little_cmc_fe", "ring_mcp_fe"): 0.04,
}
"""(angle, earlier angle): by how many degrees the mean of the first moves with each degree of the second."""


@dataclass(frozen=True, kw_only=True)
class PostureComponent:
    """One posture with its share of the mixture, the angles that are expected, and their spread."""

    name: str
    weight: float
    """Relative; above 0."""
    mean: Float[Tensor, "30"]
    """Means in the order of JOINT_DOFS, radians."""
    std: Float[Tensor, "30"]
    """Standard deviation, radians, of each angle given the ones before it."""

    def __post_init__(self) -> None:
        if not 0 < self.weight < math.inf:
            raise ValueError(f"weight of {self.name}: expected above 0 and finite, got {self.weight!r}")
        if not bool(((self.std > 0) & self.std.isfinite() & self.mean.isfinite()).all()):
            raise ValueError(f"angles of {self.name}: expected finite means and spreads above 0")


@dataclass(frozen=True, kw_only=True)
class DigitAngles:
    """A posture, digit by digit, in degrees."""

    thumb: Thumb
    index: Finger
    middle: Finger
    ring: Finger
    little: Finger
    twist: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Turn of the MCP joints about the fingers, index to little."""


def posture_component(name: str, weight: float, angles: DigitAngles, *, spread: float = 1.0) -> PostureComponent:
    """A component from angles in degrees; the outer metacarpals cup a little with the flexion of their fingers.

    spread: multiplies the spreads of all angles.
    """
    mean_deg = dict(zip(JOINT_DOFS[:6], angles.thumb, strict=True))
    cup = {"index": (0.5, 0.0), "middle": (0.5, 0.0), "ring": (1.0, 0.03), "little": (2.0, 0.06)}
    fingers = (angles.index, angles.middle, angles.ring, angles.little)
    for finger, values, turn in zip(FINGERS[1:], fingers, angles.twist, strict=True):
        mcp, spread_out, pip, *dip = values
        still, bent = cup[finger]
        mean_deg |= {
            f"{finger}_cmc_fe": still + bent * max(mcp, 0.0),
            f"{finger}_mcp_fe": mcp,
            f"{finger}_mcp_aa": spread_out,
            f"{finger}_mcp_tw": turn,
            f"{finger}_pip_fe": pip,
            f"{finger}_dip_fe": dip[0] if dip else pip * 2 / 3,
        }
    spreads = {dof: _STD_DEG.get(dof) or _STD_DEG[dof.split("_", 1)[1]] for dof in JOINT_DOFS}
    return PostureComponent(
        name=name,
        weight=weight,
        mean=torch.deg2rad(torch.tensor([mean_deg[dof] for dof in JOINT_DOFS], dtype=torch.float64, device="cpu")),
        std=spread * torch.deg2rad(torch.tensor(list(spreads.values()), dtype=torch.float64, device="cpu")),
    )
