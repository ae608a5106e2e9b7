"""Poses of hands together with the orientations that their rotation vectors are about: one record, not a pair."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand.kinematics.skeleton import DOFS, ROOT_DOFS
from torchhand.precision import own_precision, record

_ROOT = len(ROOT_DOFS)
_BUT_ROTATION = tuple(0.0 if 3 <= dof < _ROOT else 1.0 for dof in range(len(DOFS)))


@record()
@dataclass(frozen=True, kw_only=True)
class HandPose:
    """Where hands are and how their joints are bent; any batch shape.

    The root's orientation is a left perturbation of a reference, world_from_hand = exp(dofs[3:6]) · reference, so that
    no pose is near a singularity. Two records with other references may be the same pose; `normalized` gives the one
    whose rotation vector is zero.
    """

    dofs: Float[Tensor, "*batch 36"]
    """Degrees of freedom in the order of DOFS; metres and radians."""
    reference: Float[Tensor, "*batch 3 3"]
    """world_from_hand where the rotation vector is zero."""

    @classmethod
    def of(cls, dofs: Float[Tensor, "*batch 36"], reference: Float[Tensor, "*#batch 3 3"] | None = None) -> "HandPose":
        """The reference is broadcast against the poses, in their dtype; the identity where it is None."""
        if reference is None:
            reference = torch.eye(3, dtype=dofs.dtype, device=dofs.device)
        return cls(dofs=dofs, reference=reference.to(dofs).expand(*dofs.shape[:-1], 3, 3))

    @classmethod
    def cat(cls, poses: Sequence["HandPose"]) -> "HandPose":
        """Poses joined along the first batch dimension."""
        return cls(dofs=torch.cat([one.dofs for one in poses]), reference=torch.cat([one.reference for one in poses]))

    @classmethod
    def stack(cls, poses: Sequence["HandPose"]) -> "HandPose":
        """Poses stacked along a new first batch dimension."""
        dofs, reference = ([getattr(one, name) for one in poses] for name in ("dofs", "reference"))
        return cls(dofs=torch.stack(dofs), reference=torch.stack(reference))

    @property
    def batch_shape(self) -> torch.Size:
        return self.dofs.shape[:-1]

    def __len__(self) -> int:
        return len(self.dofs)

    def __getitem__(self, index: "int | slice | Int[Tensor, '...']") -> "HandPose":
        """The poses at an index of the first batch dimension."""
        return HandPose(dofs=self.dofs[index], reference=self.reference[index])

    @property
    @own_precision
    def rotation(self) -> Float[Tensor, "*batch 3 3"]:
        """world_from_hand"""
        return rotation_from_vector(self.dofs[..., 3:_ROOT]) @ self.reference

    @property
    @own_precision
    def vector(self) -> Float[Tensor, "*batch 36"]:
        """The DOFs with the rotation vector of world_from_hand itself, of length π at most."""
        turn = vector_from_rotation(self.rotation)
        return torch.cat((self.dofs[..., :3], turn, self.dofs[..., _ROOT:]), -1)

    @own_precision
    def normalized(self) -> "HandPose":
        """The same hands with zero rotation vectors."""
        kept = constant_tensor(_BUT_ROTATION, self.dofs.dtype, self.dofs.device)
        return HandPose(dofs=self.dofs * kept, reference=self.rotation)

    @own_precision
    def retract(self, step: Float[Tensor, "*#batch 36"]) -> "HandPose":
        """The hands after a step: translations and angles added, the rotation a left perturbation (world axes)."""
        here = self.normalized()
        return HandPose(dofs=here.dofs + step, reference=here.reference).normalized()

    @own_precision
    def step_to(self, other: "HandPose") -> Float[Tensor, "*batch 36"]:
        """The step that `retract` takes to the other hands."""
        turn = vector_from_rotation(other.rotation @ self.rotation.mT)
        return torch.cat(
            (other.dofs[..., :3] - self.dofs[..., :3], turn, other.dofs[..., _ROOT:] - self.dofs[..., _ROOT:]), -1
        )

    @own_precision
    def about(self, reference: Float[Tensor, "*#batch 3 3"]) -> "HandPose":
        """The same hands with rotation vectors about other references."""
        turn = vector_from_rotation(self.rotation @ reference.mT)
        dofs = torch.cat((self.dofs[..., :3], turn, self.dofs[..., _ROOT:]), -1)
        return HandPose(dofs=dofs, reference=reference.expand_as(self.reference))

    def reshape(self, *batch: int) -> "HandPose":
        """The poses with other batch dimensions."""
        return HandPose(dofs=self.dofs.reshape(*batch, len(DOFS)), reference=self.reference.reshape(*batch, 3, 3))

    def expand(self, *batch: int) -> "HandPose":
        """The poses repeated without copies."""
        return HandPose(dofs=self.dofs.expand(*batch, len(DOFS)), reference=self.reference.expand(*batch, 3, 3))

    def to(self, like: Tensor) -> "HandPose":
        """The poses in the dtype and on the device of a tensor."""
        return HandPose(dofs=self.dofs.to(like), reference=self.reference.to(like))
