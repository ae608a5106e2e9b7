"""The pose against what was expected of it: the previous frame's, or a filter's prediction with its covariance."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import rotation_from_vector, vector_from_rotation


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """A pose that is expected, in the free parameters of a pose space, with its information."""

    free: Float[Tensor, "*batch free"]
    """With the root's rotation vector about `root_reference`."""
    root_reference: Float[Tensor, "*batch 3 3"]
    whitening: Float[Tensor, "*batch free free"]
    """W with WᵀW the inverse covariance: the residual W (free - expected) is in standard deviations."""

    @classmethod
    def from_std(
        cls, free: Float[Tensor, "*batch free"], root_reference: Float[Tensor, "*batch 3 3"], std: Float[Tensor, "free"]
    ) -> "Expectation":
        """With independent errors; an infinite standard deviation expects nothing."""
        weight = torch.diag(std.reciprocal()).expand(*free.shape[:-1], -1, -1)
        return cls(free=free, root_reference=root_reference, whitening=weight)

    @classmethod
    def from_covariance(
        cls,
        free: Float[Tensor, "*batch free"],
        root_reference: Float[Tensor, "*batch 3 3"],
        covariance: Float[Tensor, "*batch free free"],
    ) -> "Expectation":
        """With the covariance of a prediction, positive definite."""
        factor = torch.linalg.cholesky(covariance)
        identity = torch.eye(free.shape[-1], dtype=free.dtype, device=free.device)
        return cls(
            free=free,
            root_reference=root_reference,
            whitening=torch.linalg.solve_triangular(factor, identity.expand_as(factor), upper=False),
        )

    def about(self, root_reference: Float[Tensor, "*batch 3 3"], columns: tuple[int, ...]) -> "Expectation":
        """The same with the rotation about another reference.

        columns: places of root_rx, root_ry and root_rz in the free parameters, -1 where one is not free.
        """
        free = self.free.expand(*root_reference.shape[:-2], -1).clone()
        vector = vector_from_rotation(self._world_from_hand(columns) @ root_reference.mT)
        own = [(column, axis) for axis, column in enumerate(columns) if column >= 0]
        if own:
            free[..., [column for column, _ in own]] = vector[..., [axis for _, axis in own]]
        return Expectation(free=free, root_reference=root_reference, whitening=self.whitening)

    def _world_from_hand(self, columns: tuple[int, ...]) -> Float[Tensor, "*batch 3 3"]:
        zero = torch.zeros_like(self.free[..., 0])
        vector = torch.stack([self.free[..., column] if column >= 0 else zero for column in columns], -1)
        return rotation_from_vector(vector) @ self.root_reference


def smoothness_residual(
    free: Float[Tensor, "*batch free"], expected: Expectation
) -> tuple[Float[Tensor, "*batch free"], Float[Tensor, "*batch free free"]]:
    """How far a pose is from the expected one, in standard deviations; both with rotations about one reference."""
    apart = free - expected.free
    whitening = expected.whitening.expand(*apart.shape[:-1], -1, -1)
    return (whitening @ apart[..., None]).squeeze(-1), whitening
