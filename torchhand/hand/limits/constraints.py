"""What a hand can do: static limits and dynamic constraints of the joint angles (Ouhaddi and Horain 1998, 3.2)."""

import math
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand.kinematics import DOFS, FINGERS, JOINT_DOFS, Skeleton
from torchhand.hand.limits.couplings import (
    ABDUCTIONS,
    FLEXIONS,
    NEIGHBOUR_BANDS_DEG,
    TIES,
    abduction_room,
    band_rows,
    nearest_on_tie,
)
from torchhand.hand.limits.violation import Violation
from torchhand.numerics import polytope
from torchhand.precision import own_precision

_ROOT = len(DOFS) - len(JOINT_DOFS)
_ROUNDING = 0.05
"""Half width over which the smooth penalty rounds the corner of equation (2) where the room for abduction ends."""


@dataclass(frozen=True, kw_only=True)
class ConstraintSettings:
    """Which dynamic constraints of Ouhaddi and Horain (1998) hold, and how hard."""

    bands: str = "paper"
    """Bands on neighbouring MCP flexions. "paper" is equation (3): the middle finger's MCP is bent at least as far as
    the index's less 25° and the ring's less 45°. That forbids a straight middle finger beside a ring finger fully bent
    at its knuckle, so the textbook "victory" (40° too far). "neighbours" is the table of Lee and Kunii (1995), which
    also forbids one straight finger beside a fully bent one: "point", "l", "shaka", "three". "none" leaves them out,
    for signs that a thumb or a wall holds (V, W, 8)."""
    ties: str = "soft"
    """Equations (1), (4) and (5), equalities: "soft" in penalties and log-probabilities only; "hard" in the feasible
    set as well, so in projections and samples."""
    abduction_vanishes_at_deg: float = 110.0
    """θ_fe,max of equation (2): MCP flexion that leaves no abduction; above 0. Ouhaddi and Horain have 110, others
    70."""
    softness_deg: float = 2.0
    """Violation of an inequality that costs ½ in the penalty; above 0."""
    dip_spread_deg: float = 8.0
    """Standard deviation about equation (1); above 0."""
    thumb_flexion_spread_deg: float = 45.0
    """Standard deviation about equation (4); above 0. Wide: Ouhaddi and Horain take it from a thumb with other axes,
    and with these a closed fist is 47° off it."""
    thumb_abduction_spread_deg: float = 20.0
    """Standard deviation about equation (5); above 0."""

    def __post_init__(self) -> None:
        if self.bands not in NEIGHBOUR_BANDS_DEG:
            raise ValueError(f"bands: expected one of {', '.join(NEIGHBOUR_BANDS_DEG)}, got {self.bands!r}")
        if self.ties not in ("soft", "hard"):
            raise ValueError(f"ties: expected 'soft' or 'hard', got {self.ties!r}")
        for name in (field.name for field in fields(self) if field.name.endswith("_deg")):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ValueError(f"{name}: expected above 0 and finite, got {value!r}")

    @property
    def tie_spread(self) -> tuple[float, ...]:
        """Standard deviation about each of TIES, radians."""
        by_equation = {
            1: self.dip_spread_deg,
            4: self.thumb_flexion_spread_deg,
            5: self.thumb_abduction_spread_deg,
        }
        return tuple(math.radians(by_equation[tie.equation]) for tie in TIES)


class PoseConstraints:
    """The feasible set of the joint angles: project onto it, measure the way to it, penalise what is outside.

    Hard: the skeleton's static limits; equation (2), the abduction of a finger's MCP joint is within its limits times
    (1 − flexion / θ_max), each side with its own limit; equation (3) as `settings.bands` says. Hard or soft: the ties,
    equations (1), (4) and (5), each clamped to the limits of the angle that follows. The root is free.

    The inequalities but (2) are linear: matrix · joints <= bound. A NaN angle is nobody's nearest: it stays NaN, and
    so do the angles that depend on it; infinite angles count as very large. Constants follow the pose's device and
    dtype. Immutable.
    """

    def __init__(self, skeleton: Skeleton, settings: ConstraintSettings | None = None) -> None:
        self.settings = settings or ConstraintSettings()
        self.skeleton = skeleton.to(dtype=torch.float64, device="cpu")
        self.vanishes_at = math.radians(self.settings.abduction_vanishes_at_deg)
        lower, upper = self.skeleton.lower, self.skeleton.upper
        self._limits = list(zip(lower.tolist(), upper.tolist(), strict=True))
        names, rows, bounds = band_rows(self.settings.bands)
        flexions = list(FLEXIONS)
        self._bands = polytope(lower[flexions], upper[flexions], rows, bounds)
        bands = torch.zeros(len(names), len(JOINT_DOFS), dtype=torch.float64)
        bands[:, flexions] = rows
        identity = torch.eye(len(JOINT_DOFS), dtype=torch.float64)
        self.matrix: Float[Tensor, "rows 30"] = torch.cat((-identity, identity, bands))
        """Linear inequalities: lower limits, upper limits, bands."""
        self.bound: Float[Tensor, "rows"] = torch.cat((-lower, upper, bounds))
        """Radians."""
        ties = TIES if self.settings.ties == "hard" else ()
        self.names: tuple[str, ...] = (
            *(f"limits of {dof}" for dof in JOINT_DOFS),
            *names,
            *(f"eq. 2: {finger}_mcp_aa at this flexion" for finger in FINGERS[1:]),
            *(tie.name for tie in ties),
        )
        """The constraints that make the feasible set, in the order of `violation`."""

    @own_precision
    def project(self, pose: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch 36"]:
        """A feasible pose near the given one; feasible poses come back as they are. Differentiable almost everywhere.

        The MCP flexions go to the nearest point of their polytope, with them each abduction to the nearest angle that
        equation (2) leaves, every other angle to its nearest limit; hard ties to the nearest pair on the tie.
        """
        root, joints = _split(pose)
        lower, upper = self.skeleton.lower.to(joints), self.skeleton.upper.to(joints)
        angles = list(joints.clamp(lower, upper).unbind(-1))
        flexion = self._bands.nearest(joints[..., list(FLEXIONS)])
        flexion = flexion.clamp(lower[list(FLEXIONS)], upper[list(FLEXIONS)])
        room = abduction_room(flexion, self.vanishes_at)
        for i, (fe, aa) in enumerate(zip(FLEXIONS, ABDUCTIONS, strict=True)):
            angles[fe] = flexion[..., i]
            angles[aa] = joints[..., aa].clamp(lower[aa] * room[..., i], upper[aa] * room[..., i])
        if self.settings.ties == "hard":
            for tie in TIES:
                source, target = (self.limits(index) for index in (tie.source, tie.target))
                angles[tie.source], angles[tie.target] = nearest_on_tie(
                    joints[..., tie.source], joints[..., tie.target], tie, source, target
                )
        return torch.cat((root, torch.stack(angles, -1)), -1)

    @own_precision
    def violation(self, pose: Float[Tensor, "*batch 36"]) -> Violation:
        """How far the pose is outside each constraint of the feasible set."""
        _, joints = _split(pose)
        linear = (joints @ self.matrix.to(joints).T - self.bound.to(joints)).clamp_min(0)
        count = len(JOINT_DOFS)
        parts = [torch.maximum(linear[..., :count], linear[..., count : 2 * count]), linear[..., 2 * count :]]
        lower, upper = self.abduction_limits(joints[..., list(FLEXIONS)])
        abduction = joints[..., list(ABDUCTIONS)]
        parts.append(torch.maximum(lower - abduction, abduction - upper).clamp_min(0))
        if self.settings.ties == "hard":
            parts.append(self.tie_residuals(pose).abs())
        return Violation(names=self.names, amount=torch.cat(parts, -1), is_angle=True)

    @own_precision
    def is_feasible(self, pose: Float[Tensor, "*batch 36"], tolerance: float = 1e-6) -> Bool[Tensor, "*batch"]:
        """Whether no constraint is violated by more than the tolerance (radians); never with NaN angles."""
        return self.violation(pose).worst <= tolerance

    @own_precision
    def abduction_limits(
        self, flexion: Float[Tensor, "*batch 4"]
    ) -> tuple[Float[Tensor, "*batch 4"], Float[Tensor, "*batch 4"]]:
        """Lower and upper limit of the MCP abductions at the MCP flexions, index to little: equation (2)."""
        room = abduction_room(flexion, self.vanishes_at)
        lower, upper = (limit[list(ABDUCTIONS)].to(flexion) for limit in (self.skeleton.lower, self.skeleton.upper))
        return lower * room, upper * room

    @own_precision
    def tie_residuals(self, pose: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch ties"]:
        """Residual of each of TIES, radians: the angle less what the tie asks for within its limits."""
        _, joints = _split(pose)
        missed = [joints[..., tie.target] - self.tied_angle(i, joints) for i, tie in enumerate(TIES)]
        return torch.stack(missed, -1)

    def tied_angle(self, index: int, joints: Float[Tensor, "*batch 30"]) -> Float[Tensor, "*batch"]:
        """What tie number `index` asks of the angle that follows: within its limits, the corners of the clamp exact."""
        tie = TIES[index]
        return (tie.factor * joints[..., tie.source] + tie.offset).clamp(*self.limits(tie.target))

    @own_precision
    def penalty(self, pose: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch"]:
        """`wall` plus `tie_energy`: a smooth cost without unit."""
        return self.wall(pose) + self.tie_energy(pose)

    @own_precision
    def wall(self, pose: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch"]:
        """½ Σ (violation / softness)² of the inequalities; once continuously differentiable, zero where all hold.

        Where the room for abduction ends (flexion within 5 % of θ_max) the corner of equation (2) is rounded outwards,
        so that up to 1/80 of the abduction's limit (0.4°) too much costs nothing there; the default θ_max lies beyond
        the limits of flexion.
        """
        _, joints = _split(pose)
        linear = (joints @ self.matrix.to(joints).T - self.bound.to(joints)).clamp_min(0)
        room = _rounded(1 - joints[..., list(FLEXIONS)] / self.vanishes_at)
        abduction = joints[..., list(ABDUCTIONS)]
        lower, upper = (limit[list(ABDUCTIONS)].to(joints) for limit in (self.skeleton.lower, self.skeleton.upper))
        beyond = (lower * room - abduction).clamp_min(0).square() + (abduction - upper * room).clamp_min(0).square()
        return (linear.square().sum(-1) + beyond.sum(-1)) / (2 * math.radians(self.settings.softness_deg) ** 2)

    @own_precision
    def tie_energy(self, pose: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch"]:
        """½ Σ (residual / spread)² of the ties; continuously differentiable: the clamp's corners are rounded by 1°."""
        _, joints = _split(pose)
        width = math.radians(2.0)
        energy = torch.zeros_like(joints[..., 0])
        for tie, spread in zip(TIES, self.settings.tie_spread, strict=True):
            low, high = self.limits(tie.target)
            wanted = tie.factor * joints[..., tie.source] + tie.offset
            wanted = low + _rounded(wanted - low, width) - _rounded(wanted - high, width)
            energy = energy + 0.5 * ((joints[..., tie.target] - wanted) / spread).square()
        return energy

    def limits(self, index: int) -> tuple[float, float]:
        """Lower and upper limit of one of JOINT_DOFS, radians."""
        return self._limits[index]


def _split(pose: Tensor) -> tuple[Tensor, Tensor]:
    if pose.shape[-1] != len(DOFS):
        raise ValueError(f"pose: expected {len(DOFS)} numbers in the last dimension, got shape {tuple(pose.shape)}")
    return pose[..., :_ROOT], pose[..., _ROOT:]


def _rounded(value: Tensor, width: float = _ROUNDING) -> Tensor:
    """max(value, 0) with its corner rounded outwards by a parabola over ±width; width / 4 above it at most."""
    return torch.where(value > width, value, (value + width).clamp_min(0).square() / (4 * width))
