"""Constraints between joint angles as residuals (Ouhaddi and Horain 1998, section 3.2)."""

import math
from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import kept
from torchhand.hand import DOFS, JOINT_DOFS, PoseConstraints
from torchhand.hand.limits import ABDUCTIONS, FLEXIONS, TIES

_ROOT = len(DOFS) - len(JOINT_DOFS)
_COUNT = len(JOINT_DOFS)
_FINGERS = len(FLEXIONS)


@dataclass(frozen=True, kw_only=True)
class DynamicConstraints:
    """Ouhaddi and Horain 1998, eq. 1 to 5, with all constants multiplied out once.

    Rows: the bands on neighbouring MCP flexions (eq. 3, or as the constraints' settings say) and the four abductions
    at their flexions (eq. 2), each over the softness and 0 where the constraint holds; then the ties (eq. 1, 4, 5),
    each over its spread.
    """

    constraints: PoseConstraints

    def of_joints(
        self, pose: Float[Tensor, "*batch 36"], *, has_ties: bool = True
    ) -> tuple[Float[Tensor, "*batch rows"], Float[Tensor, "*batch rows 30"]]:
        """Residuals and their derivative in the joint angles. has_ties: whether the ties are among the rows."""
        c, joints = _constants_of(self.constraints, pose.dtype, pose.device), pose[..., _ROOT:]
        bent, abduction, flexion = (joints @ c.rows.mT).split((len(c.bound), _FINGERS, _FINGERS), -1)
        room = 1 - flexion.clamp(0.0, 1.0)  # eq. 2
        beyond = abduction - torch.minimum(torch.maximum(abduction, c.lower * room), c.upper * room)
        values = torch.cat(((bent - c.bound).clamp_min(0), beyond), -1)
        is_over = values != 0
        slopes = is_over[..., None] * c.rows[:-_FINGERS]
        # What the room takes from the limit that is exceeded.
        shrinks = torch.where(beyond > 0, c.upper, c.lower) * ((room > 0) & (room < 1)) * is_over[..., -_FINGERS:]
        slopes[..., -_FINGERS:, :] += shrinks[..., None] * c.rows[-_FINGERS:]
        if not has_ties:
            return values, slopes
        wanted = c.tie_factor * joints[..., c.sources] + c.tie_offset
        followed = torch.minimum(torch.maximum(wanted, c.tie_lower), c.tie_upper)
        missed = (joints[..., c.targets] - followed) / c.tie_spread
        of_ties = c.target_rows - (wanted == followed)[..., None] * c.source_rows
        return torch.cat((values, missed), -1), torch.cat((slopes, of_ties), -2)


@dataclass(frozen=True, kw_only=True)
class _Constants:
    """Numbers of the constraints, laid out once."""

    rows: Float[Tensor, "rows 30"]
    """Rows of the bands and of the abductions, over the softness; then of the flexions, over that which leaves no
    room."""
    bound: Float[Tensor, "bands"]
    """Over the softness, like the limits."""
    lower: Float[Tensor, "4"]
    """Limits of the abductions."""
    upper: Float[Tensor, "4"]
    sources: Int[Tensor, "ties"]
    targets: Int[Tensor, "ties"]
    tie_factor: Float[Tensor, "ties"]
    tie_offset: Float[Tensor, "ties"]
    tie_lower: Float[Tensor, "ties"]
    """Limits of the angles that follow, radians."""
    tie_upper: Float[Tensor, "ties"]
    tie_spread: Float[Tensor, "ties"]
    source_rows: Float[Tensor, "ties 30"]
    """Times the factors and over the spreads, like those of the targets."""
    target_rows: Float[Tensor, "ties 30"]

    @classmethod
    def of(cls, constraints: PoseConstraints) -> "_Constants":
        skeleton, settings = constraints.skeleton, constraints.settings
        softness, unit = math.radians(settings.softness_deg), torch.eye(_COUNT, dtype=torch.float64)
        abductions = torch.tensor(ABDUCTIONS)
        sources, targets = (torch.tensor([getattr(tie, name) for tie in TIES]) for name in ("source", "target"))
        factor, offset = (unit.new_tensor([getattr(tie, name) for tie in TIES]) for name in ("factor", "offset"))
        spread = unit.new_tensor(settings.tie_spread)
        softened = torch.cat((constraints.matrix[2 * _COUNT :], unit[abductions])) / softness
        return cls(
            rows=torch.cat((softened, unit[list(FLEXIONS)] / constraints.vanishes_at)),
            bound=constraints.bound[2 * _COUNT :] / softness,
            lower=skeleton.lower[abductions] / softness,
            upper=skeleton.upper[abductions] / softness,
            sources=sources,
            targets=targets,
            tie_factor=factor,
            tie_offset=offset,
            tie_lower=skeleton.lower[targets],
            tie_upper=skeleton.upper[targets],
            tie_spread=spread,
            source_rows=(factor / spread)[:, None] * unit[sources],
            target_rows=unit[targets] / spread[:, None],
        )

    def to(self, dtype: torch.dtype, device: torch.device) -> "_Constants":
        """The constants in a dtype and on a device."""
        tensors = {f.name: getattr(self, f.name).to(device) for f in fields(self)}
        return _Constants(**{name: x.to(dtype) if x.is_floating_point() else x for name, x in tensors.items()})


@kept(8)
def _constants_of(constraints: PoseConstraints, dtype: torch.dtype, device: torch.device) -> _Constants:
    return _Constants.of(constraints).to(dtype, device)
