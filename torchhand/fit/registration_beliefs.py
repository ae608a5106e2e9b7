"""What registration believes of a pose besides the picture: constraints, the posture prior, an expected pose."""

import math
from dataclasses import dataclass, fields
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit.limits import DynamicConstraints
from torchhand.fit.posture import PostureResiduals
from torchhand.fit.smoothness import Expectation
from torchhand.hand import PoseConstraints, PoseSpace
from torchhand.numerics import NormalEquations

_ROOT = 6


@dataclass(frozen=True, kw_only=True)
class HeldBeliefs:
    """What is held of the beliefs between two looks; a row per hypothesis. Residuals are in standard deviations."""

    posture: Float[Tensor, "k 30 30"] | None
    """Residuals of the prior's likeliest posture: this times the joint angles, less the offset."""
    posture_offset: Float[Tensor, "k 30"] | None
    posture_matrix: Float[Tensor, "k 30 30"] | None
    """Their matrix of the normal equations."""
    expected: Float[Tensor, "k free"] | None
    """Free parameters of the expected pose, about the references that are held."""
    expected_matrix: Float[Tensor, "k free free"] | None
    """The inverse of its covariance."""

    def rows(self, rows: Int[Tensor, "n"]) -> "HeldBeliefs":
        """The given hypotheses."""

        def own(name: str) -> Any:
            value = getattr(self, name)
            return None if value is None else value[rows]

        return HeldBeliefs(**{f.name: own(f.name) for f in fields(self)})


@dataclass(frozen=True, kw_only=True)
class Beliefs:
    """The beliefs of one registration."""

    space: PoseSpace
    constraints: DynamicConstraints | None
    constraint_weight: float
    prior: PostureResiduals | None
    prior_weight: float
    prior_tail: float = math.inf
    """Degrees of freedom of the prior as a Student's t distribution: the fewer, the less an unusual posture is pulled;
    infinite for a normal one."""

    @classmethod
    def of(
        cls,
        space: PoseSpace,
        constraints: PoseConstraints | None,
        prior: PostureResiduals | None,
        *,
        constraint_weight: float,
        prior_weight: float,
    ) -> "Beliefs":
        """Those that are given any weight, where the space moves the joints at all."""
        moves_joints = bool(space.basis[_ROOT:].any())
        dynamic = None
        if constraints is not None and moves_joints and constraint_weight > 0:
            dynamic = DynamicConstraints(constraints=constraints)
        return cls(
            space=space,
            constraints=dynamic,
            constraint_weight=constraint_weight,
            prior=prior if moves_joints and prior_weight > 0 else None,
            prior_weight=prior_weight,
        )

    def held(self, pose: Float[Tensor, "k 36"], expected: Expectation | None) -> HeldBeliefs:
        """Those of hypotheses in such poses. expected: with the rotations about the references that are held."""
        posture = offset = matrix = None
        if self.prior is not None:
            known = pose.nan_to_num()
            kind = self.prior.likeliest(known)
            posture, offset = self.prior.matrix.to(pose)[kind], self.prior.offset.to(pose)[kind]
            scale = (self.prior_weight * self._tail_weight(posture, offset, known)).sqrt()
            posture, offset = scale[:, None, None] * posture, scale[:, None] * offset
            matrix = posture.mT @ posture
        return HeldBeliefs(
            posture=posture,
            posture_offset=offset,
            posture_matrix=matrix,
            expected=None if expected is None else expected.free,
            expected_matrix=None if expected is None else expected.whitening.mT @ expected.whitening,
        )

    def _tail_weight(self, posture: Tensor, offset: Tensor, pose: Tensor) -> Float[Tensor, "k"]:
        """What the prior counts at a posture: 1 where it is about as unusual as its own samples are."""
        if math.isinf(self.prior_tail):
            return torch.ones_like(pose[:, 0])
        away = ((posture @ pose[:, _ROOT:, None]).squeeze(-1) - offset).square().sum(-1)
        return (self.prior_tail + offset.shape[-1]) / (self.prior_tail + away)

    def of_joints(self, pose: Float[Tensor, "k 36"], held: HeldBeliefs) -> NormalEquations | None:
        """Constraints and prior, in the thirty joint angles; None if there are none of them."""
        found = None
        if self.constraints is not None:
            # The posture prior, where there is one, holds the ties already.
            value, slope = self.constraints.of_joints(pose, has_ties=self.prior is None)
            weighted = self.constraint_weight * slope
            gradient, cost = (value[:, None] @ weighted).squeeze(1), 0.5 * value.square().sum(-1)
            found = NormalEquations(matrix=slope.mT @ weighted, gradient=gradient, cost=self.constraint_weight * cost)
        if held.posture is not None and held.posture_offset is not None and held.posture_matrix is not None:
            missed = (held.posture @ pose[:, _ROOT:, None]).squeeze(-1) - held.posture_offset
            gradient, cost = (missed[:, None] @ held.posture).squeeze(1), 0.5 * missed.square().sum(-1)
            if found is None:
                return NormalEquations(matrix=held.posture_matrix, gradient=gradient, cost=cost)
            found = NormalEquations(
                matrix=found.matrix + held.posture_matrix, gradient=found.gradient + gradient, cost=found.cost + cost
            )
        return found

    def of_free(self, values: Float[Tensor, "k free"], held: HeldBeliefs) -> NormalEquations | None:
        """The expected pose, in the free parameters; None if none is expected."""
        if held.expected is None or held.expected_matrix is None:
            return None
        apart = values - held.expected
        gradient = (held.expected_matrix @ apart[..., None]).squeeze(-1)
        return NormalEquations(matrix=held.expected_matrix, gradient=gradient, cost=0.5 * (apart * gradient).sum(-1))
