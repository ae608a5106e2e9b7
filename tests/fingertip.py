"""A new kind of observation, all of it: the ray from a camera on which the index fingertip lies.

Nothing in the library knows of it. Tests hand it to the solver, to the shape fit and to the tracker.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.hand import KEYPOINTS, HandKinematics, PoseJacobian, ShapeJacobian

TIP = KEYPOINTS.index("index_tip")


@dataclass(frozen=True, kw_only=True)
class FingertipRay:
    """The index fingertip as seen by one camera: a ray in the world."""

    origin: Float[Tensor, "3"]
    direction: Float[Tensor, "3"]
    """Unit."""
    kinematics: HandKinematics
    jacobian: PoseJacobian
    """Of the keypoints of these kinematics in the pose."""
    std_m: float = 0.001
    """Standard deviation of the fingertip's distance from the ray, in each direction."""
    view: int = 0

    @property
    def is_empty(self) -> bool:
        return not bool(self.direction.isfinite().all())

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "FingertipRay":
        """The same for all hypotheses."""
        return self

    def associate(self, hands: PosedHands, stage: Stage) -> "FingertipRayFactor":
        """There is nothing to decide: one point belongs to one ray."""
        factor = FingertipRayFactor(ray=self, distance=hands.shape.new_zeros(len(hands)))
        return replace(factor, distance=factor.offset(hands).norm(dim=-1))


@dataclass(frozen=True, kw_only=True)
class FingertipRayFactor:
    """½ |distance from the ray|² / std²; a row per hand."""

    ray: FingertipRay
    distance: Float[Tensor, "k"]
    """At the association, metres."""

    @property
    def across(self) -> Float[Tensor, "3 3"]:
        """What takes from a vector its part along the ray."""
        direction = self.ray.direction
        return torch.eye(3, dtype=direction.dtype) - direction[:, None] * direction

    def offset(self, hands: PosedHands) -> Float[Tensor, "k 3"]:
        """From the ray to the fingertip, metres."""
        frames = self.ray.kinematics(hands.pose.dofs, hands.shape, root_reference=hands.pose.reference)
        return (frames.keypoints[:, TIP] - self.ray.origin) @ self.across

    def equations(self, hands: PosedHands) -> Equations:
        """In the DOFs, and in the shape where it is unknown."""
        kinematics, pose = self.ray.kinematics, hands.pose
        frames = kinematics(pose.dofs, hands.shape, root_reference=pose.reference)
        offset = self.offset(hands)
        weight = torch.full_like(offset, self.ray.std_m**-2)
        cost, shared = 0.5 * (weight * offset.square()).sum(-1), None
        if hands.unknowns is not None:
            slopes = ShapeJacobian(kinematics, hands.unknowns.columns)(frames, hands.shape)[:, TIP]
            shared = self.across @ torch.nn.functional.pad(slopes, (0, len(hands.unknowns.extra)))
        rows = self.across @ self.ray.jacobian(pose.dofs, frames)[:, TIP]
        return Equations.of_rows(offset, weight, rows, cost, shared=shared)

    def rows(self, rows: Int[Tensor, "n"]) -> "FingertipRayFactor":
        """Of some of the hands."""
        return replace(self, distance=self.distance[rows])

    def explained(self) -> tuple[Explained, ...]:
        """Whether the fingertip is on the ray."""
        is_on = (self.distance < 3 * self.ray.std_m).to(self.distance)
        return (Explained(name="fingertip", view=self.ray.view, fraction=is_on, distance=self.distance),)
