"""Static limits and dynamic constraints of the joint angles as residuals (paper 000, section 3.2; FACTS 2)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import DOFS, JOINT_DOFS, PoseConstraints
from torchhand.hand.couplings import ABDUCTIONS, FLEXIONS, TIES

_ROOT = len(DOFS) - len(JOINT_DOFS)
_COUNT = len(JOINT_DOFS)


def limit_residual(
    pose: Float[Tensor, "*batch 36"], basis: Float[Tensor, "36 free"], constraints: PoseConstraints
) -> tuple[Float[Tensor, "*batch 30"], Float[Tensor, "*batch 30 free"]]:
    """How far each angle is beyond its static limits, over the softness; 0 within. Signed: positive above."""
    joints = pose[..., _ROOT:]
    lower, upper = constraints.skeleton.lower.to(joints), constraints.skeleton.upper.to(joints)
    softness = math.radians(constraints.settings.softness_deg)
    beyond = joints - torch.minimum(torch.maximum(joints, lower), upper)
    rows = (beyond != 0).to(joints)[..., None] * basis[_ROOT:]
    return beyond / softness, rows / softness


@dataclass(frozen=True, kw_only=True)
class DynamicConstraints:
    """Equations (1) to (5) of paper 000 as residuals in a pose space, constants multiplied out once.

    Rows: the bands on neighbouring MCP flexions (equation 3, or as the constraints' settings say) and the four
    abductions at their flexions (equation 2), each over the softness and 0 where the constraint holds; then the ties
    (equations 1, 4, 5), each over its spread.
    """

    constraints: PoseConstraints
    basis: Float[Tensor, "36 free"]

    def residual(
        self, pose: Float[Tensor, "*batch 36"]
    ) -> tuple[Float[Tensor, "*batch rows"], Float[Tensor, "*batch rows free"]]:
        joints, (value, slope) = pose[..., _ROOT:], self.of_joints(pose)
        return value, slope @ self.basis[_ROOT:].to(joints)

    def of_joints(
        self, pose: Float[Tensor, "*batch 36"]
    ) -> tuple[Float[Tensor, "*batch rows"], Float[Tensor, "*batch rows 30"]]:
        """The same, derived in the joint angles."""
        joints = pose[..., _ROOT:]
        settings, skeleton = self.constraints.settings, self.constraints.skeleton
        softness = math.radians(settings.softness_deg)
        matrix, bound = (x[2 * _COUNT :].to(joints) for x in (self.constraints.matrix, self.constraints.bound))
        over = (joints @ matrix.T - bound).clamp_min(0) / softness
        of_bands = (over > 0).to(joints)[..., None] * (matrix / softness)

        flexion, abduction = joints[..., list(FLEXIONS)], joints[..., list(ABDUCTIONS)]
        low, high = self.constraints.abduction_limits(flexion)
        beyond = (abduction - torch.minimum(torch.maximum(abduction, low), high)) / softness
        end = self.constraints.vanishes_at
        limit = torch.where(beyond > 0, skeleton.upper.to(joints)[list(ABDUCTIONS)], 0.0)
        limit = torch.where(beyond < 0, skeleton.lower.to(joints)[list(ABDUCTIONS)], limit)
        shrinks = limit * ((flexion > 0) & (flexion < end)) / (end * softness)  # what the room takes from the limit
        unit = torch.eye(_COUNT, dtype=joints.dtype, device=joints.device)
        of_room = ((beyond != 0).to(joints) / softness)[..., None] * unit[list(ABDUCTIONS)]
        of_room = of_room + shrinks[..., None] * unit[list(FLEXIONS)]

        spread = joints.new_tensor(settings.tie_spread)
        sources, targets = [tie.source for tie in TIES], [tie.target for tie in TIES]
        factor, offset = (joints.new_tensor([getattr(tie, name) for tie in TIES]) for name in ("factor", "offset"))
        wanted = factor * joints[..., sources] + offset
        held = torch.minimum(
            torch.maximum(wanted, skeleton.lower.to(joints)[targets]), skeleton.upper.to(joints)[targets]
        )
        missed = (joints[..., targets] - held) / spread
        of_ties = (
            unit[targets] / spread[:, None] - ((wanted == held).to(joints) * factor / spread)[..., None] * unit[sources]
        )
        return torch.cat((over, beyond, missed), -1), torch.cat((of_bands, of_room, of_ties), -2)
