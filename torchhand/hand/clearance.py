"""Keeps the digits of a moving hand apart: measures overlap, and moves postures as little as it takes to end it."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.kinematics import DOFS, JOINT_DOFS, HandKinematics
from torchhand.hand.limits import ABDUCTIONS, FLEXIONS, ConstraintSettings, PoseConstraints
from torchhand.hand.primitives import PrimitiveSizes, penetration, place_primitives, primitive_sizes
from torchhand.numerics import LevenbergMarquardtSettings, levenberg_marquardt

_ROOT = len(DOFS) - len(JOINT_DOFS)
_YIELDING = [
    i
    for i, dof in enumerate(JOINT_DOFS)
    if dof.endswith(("_mcp_aa", "_mcp_tw")) or dof in ("thumb_cmc_fe", "thumb_cmc_aa", "thumb_mcp_fe", "thumb_ip_fe")
]
"""What gives way first: sideways and twist at the knuckles, and the thumb."""
_AT_PALM = " – palm"
_FROM = 0.2e-3
"""Overlap that is left as it is, metres."""
_DEPTH, _CLEARANCE, _TURN, _ROOM = 0.15e-3, 0.1e-3, math.radians(4.0), math.radians(0.5)
_STEP = 1e-6  # radians
_LAST = [i for i, dof in enumerate(JOINT_DOFS) if dof == "thumb_cmc_fe" or not dof.endswith("_cmc_fe")]
"""All but the CMC joints of the fingers: the palm is one part, which does not bend with them."""
_ROUNDS = (_YIELDING, _YIELDING, _LAST)
_SETTINGS = LevenbergMarquardtSettings(iterations=12, cost_tolerance=1e-3)


class Clearance:
    """Overlap of the parts of right hands of one shape; left hands are the same mirrored."""

    def __init__(
        self, kinematics: HandKinematics, shape: Float[Tensor, "shape"] | None = None, *, palm_gap: float = 0.0
    ) -> None:
        """kinematics: of the right hand, float64. palm_gap: room between a finger and the palm that counts as none,
        metres: for skins that stand out from the primitives of the palm.
        """
        self._kinematics = kinematics
        self._shape = kinematics.default_shape.double() if shape is None else shape.double()
        self._sizes: PrimitiveSizes = primitive_sizes(kinematics.shape_space, self._shape)
        self._palm_gap = palm_gap
        self._constraints = PoseConstraints(kinematics.skeleton, ConstraintSettings(bands="none"))

    def depths(self, joints: Float[Tensor, "*batch 30"]) -> Float[Tensor, "*batch pairs"]:
        """How deep each pair of parts is in each other, metres: no slack for soft skin; minus the gap where apart,
        which is shorter by `palm_gap` at the palm.
        """
        pose = torch.cat((joints.new_zeros(*joints.shape[:-1], _ROOT), joints), -1)
        found = penetration(place_primitives(self._kinematics(pose, self._shape), self._sizes))
        gaps = [self._palm_gap if name.endswith(_AT_PALM) else 0.0 for name in found.names]
        return found.depth + found.depth.new_tensor(gaps)

    def worst(self, joints: Float[Tensor, "*batch 30"]) -> Float[Tensor, "*batch"]:
        """The deepest overlap of any two parts, metres; below 0 the smallest gap."""
        return self.depths(joints).amax(-1)

    def separated(self, joints: Float[Tensor, "postures 30"]) -> Float[Tensor, "postures 30"]:
        """The nearest postures within the limits whose parts hardly overlap; those that are such already stay as they
        are.

        Least squares over the angles that give way, for each posture on its own; further rounds, the last one over all
        angles but those within the palm, where one is not enough.
        """
        for columns in _ROUNDS:
            overlapping = (self.worst(joints) > _FROM).nonzero()[:, 0]
            if not len(overlapping):
                break
            moved = joints.clone()
            moved[overlapping] = self._moved(joints[overlapping], columns)
            joints = moved
        return joints

    def _moved(self, base: Float[Tensor, "postures 30"], columns: list[int]) -> Float[Tensor, "postures 30"]:
        """One round: the least squares about the given postures, over these angles."""
        skeleton = self._constraints.skeleton

        def linearise(free: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
            return self._linearised(free, base[rows], columns)

        found = levenberg_marquardt(
            linearise,
            base[:, columns],
            lower=skeleton.lower[columns],
            upper=skeleton.upper[columns],
            settings=_SETTINGS,
            takes_rows=True,
        )
        moved = base.clone()
        moved[:, columns] = found.values
        return moved

    def _linearised(
        self, free: Float[Tensor, "postures free"], fixed: Float[Tensor, "postures 30"], columns: list[int]
    ) -> tuple[Float[Tensor, "postures residuals"], Float[Tensor, "postures residuals free"]]:
        """Residuals and their Jacobian, by differences: all postures and steps in one batch."""
        steps = torch.cat((free.new_zeros(1, free.shape[-1]), _STEP * torch.eye(free.shape[-1], dtype=free.dtype)))
        stepped = free[:, None] + steps
        joints = fixed[:, None].expand(-1, len(steps), -1).clone()
        joints[..., columns] = stepped
        low, high = self._constraints.abduction_limits(joints[..., list(FLEXIONS)])
        aside = joints[..., list(ABDUCTIONS)]
        values = torch.cat(
            (
                (stepped - fixed[:, None, columns]) / _TURN,
                (self.depths(joints) + _CLEARANCE).clamp_min(0) / _DEPTH,
                ((low - aside).clamp_min(0) + (aside - high).clamp_min(0)) / _ROOM,
            ),
            -1,
        )
        return values[:, 0], ((values[:, 1:] - values[:, :1]) / _STEP).mT
