"""Channels of a pose stream: their steps, which of them move together, and rotation vectors that do not jump."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.export.stream.container import MAX_POSES
from torchhand.hand import FINGERS, ROOT_DOFS

_NEIGHBOUR = dict(zip(FINGERS[2:], FINGERS[1:-1], strict=True))


@dataclass(frozen=True, kw_only=True)
class StreamSettings:
    """How fine a stream is; the defaults keep recorded human motion within 1 degree on average."""

    step_deg: float = 3.5
    """Step of the joint angles, degrees; above 0, 30 at most."""
    root_step_deg: float = 1.5
    """Step of the rotation vector of the whole hand, degrees; above 0, 30 at most."""
    root_step_mm: float = 2.0
    """Step of its place, millimetres; above 0, 1000 at most."""
    dead_zone: float = 0.55
    """A value that is nearer than so many steps stays as it was; 0.5 to 1."""
    packet_poses: int = 15
    """Poses of a packet, 1 to 255: how many frames a reader of a growing stream waits. Fewer take more bits."""

    def __post_init__(self) -> None:
        for name, maximum in (("step_deg", 30), ("root_step_deg", 30), ("root_step_mm", 1000)):
            if not 0 < getattr(self, name) <= maximum:
                raise ValueError(f"{name}: expected more than 0, {maximum} at most, got {getattr(self, name):g}")
        if not 0.5 <= self.dead_zone <= 1:
            raise ValueError(f"dead_zone: expected 0.5 to 1, got {self.dead_zone:g}")
        if not 1 <= self.packet_poses <= MAX_POSES:
            raise ValueError(f"packet_poses: expected 1 to {MAX_POSES}, got {self.packet_poses}")

    def step_of(self, dof: str) -> float:
        """Step of one of DOFS, metres or radians."""
        if dof.startswith("root_t"):
            return 1e-3 * self.root_step_mm
        return math.radians(self.root_step_deg if dof in ROOT_DOFS else self.step_deg)


def unwrapped(
    vectors: Float64[Tensor, "frames 3"], start: Float64[Tensor, "1 3"] | None = None
) -> Float64[Tensor, "frames 3"]:
    """The same rotations as rotation vectors without jumps by a whole turn: each the nearest to the one before.

    start: the one before the first, where there is one.
    """
    found = vectors.clone()
    before = vectors[0] if start is None else start[0]
    for i in range(0 if start is not None else 1, len(found)):
        here = vectors[i]
        axis = torch.nn.functional.normalize(here if float(here.norm()) > 1e-9 else before, dim=0)
        turns = torch.round((before - here) @ axis / (2 * math.pi))
        before = found[i] = here + 2 * math.pi * turns * axis
    return found


def partners(names: list[str]) -> list[int | None]:
    """Which DOF each tends to move with: a DIP with its PIP, a finger's joint with its neighbour's, the thumb's joints
    with its first."""
    found: list[int | None] = []
    for place, dof in enumerate(names):
        finger, _, joint = dof.partition("_")
        if joint == "dip_fe":
            likely = f"{finger}_pip_fe"
        elif finger in _NEIGHBOUR:
            likely = f"{_NEIGHBOUR[finger]}_{joint}"
        else:
            likely = {"index": "index_mcp_fe", "thumb": "thumb_cmc_fe"}.get(finger, "")
        found.append(names.index(likely) if likely in names[:place] else None)
    return found
