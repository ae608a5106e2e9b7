"""The cost of a registration between two looks at the model: residuals of a picture's contours as normal equations."""

from dataclasses import dataclass, fields, replace

from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.hand import PoseSpace
from torchhand.image.distance_fields import Boundary, DistanceField
from torchhand.numerics import NormalEquations, RobustLoss
from torchhand.residuals import (
    DynamicConstraints,
    Expectation,
    PostureResiduals,
    coverage_residual,
    outer_contour_residual,
    smoothness_residual,
    summed,
    valley_residual,
    weighted_equations,
)
from torchhand.track.limits import clamp_to_limits
from torchhand.view.contours import ContourLook, Contours

_ROOT = 6
_TIES = 6  # last rows of the dynamic constraints: the posture prior holds them already


@dataclass(frozen=True, kw_only=True)
class Beliefs:
    """What is believed of a pose besides the picture."""

    space: PoseSpace
    constraints: DynamicConstraints | None
    constraint_weight: float
    prior: PostureResiduals | None
    prior_weight: float

    def equations(
        self, pose: Float[Tensor, "k 36"], moving: Bool[Tensor, "k 36"], posture: Int[Tensor, "k"]
    ) -> list[NormalEquations]:
        """moving: DOFs that follow the free parameters at this pose."""
        basis = moving[:, _ROOT:, None] * self.space.basis[_ROOT:]
        terms = []
        if self.constraints is not None:
            residual, slope = self.constraints.of_joints(pose)
            if self.prior is not None:
                residual, slope = residual[..., :-_TIES], slope[..., :-_TIES, :]
            terms.append(_times(self.constraint_weight, residual, slope @ basis))
        if self.prior is not None:
            residual, slope = self.prior.of_joints(pose, posture)
            terms.append(_times(self.prior_weight, residual, slope @ basis))
        return terms


def _times(weight: float, residual: Tensor, slope: Tensor) -> NormalEquations:
    """Of residuals that all have one weight."""
    if weight != 1:
        residual, slope = weight**0.5 * residual, weight**0.5 * slope
    return weighted_equations(residual, slope)


@dataclass(frozen=True, kw_only=True)
class LookedAt:
    """What is held between two looks; a row per hypothesis."""

    root_reference: Float[Tensor, "k 3 3"]
    look: ContourLook
    channel: Int[Tensor, "k points"]
    """Of the oriented distance map, per model point."""
    match: Int[Tensor, "k boundary"]
    """The model point of every point of the picture's contour."""
    outer_weight: Float[Tensor, "k points"]
    inner_weight: Float[Tensor, "k points"]
    coverage_weight: Float[Tensor, "k boundary"]
    posture: Int[Tensor, "k"]
    """Of the prior's mixture."""
    expected: Expectation | None

    def rows(self, rows: Int[Tensor, "n"]) -> "LookedAt":
        """The given hypotheses."""
        if len(rows) == len(self.posture):
            return self
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("look", "expected")}
        expected = self.expected
        if expected is not None:
            parts = {f.name: getattr(expected, f.name)[rows] for f in fields(expected)}
            expected = replace(expected, **parts)
        return LookedAt(
            look=self.look.rows(rows), expected=expected, **{name: value[rows] for name, value in own.items()}
        )


@dataclass(frozen=True, kw_only=True)
class RegistrationCost:
    """½ Σ weight ρ(residual) of all kinds; weights are inverse variances, px⁻²."""

    contours: Contours
    beliefs: Beliefs
    held: LookedAt
    field: DistanceField
    boundary: Boundary
    valleys: DistanceField | None
    robust: RobustLoss
    valley_robust: RobustLoss
    unmatched_px: float

    def equations(self, values: Float[Tensor, "k free"], rows: Int[Tensor, "k"]) -> NormalEquations:
        """At free parameters of the given hypotheses, rotations about the references that are held."""
        held = self.held.rows(rows)
        wanted = self.beliefs.space.dof(values)
        pose = clamp_to_limits(wanted, self.contours.kinematics.skeleton)
        moving = pose == wanted
        motion = self.contours.motion(pose, held.root_reference, held.look, moving)
        terms = [
            weighted_equations(
                *outer_contour_residual(motion, self.field, held.channel), held.outer_weight, self.robust
            ),
            weighted_equations(
                *coverage_residual(
                    motion, self.boundary, held.match, held.look.normals, unmatched_px=self.unmatched_px
                ),
                held.coverage_weight,
                self.robust,
            ),
        ]
        if self.valleys is not None:
            terms.append(
                weighted_equations(*valley_residual(motion, self.valleys), held.inner_weight, self.valley_robust)
            )
        terms += self.beliefs.equations(pose, moving, held.posture)
        if held.expected is not None:
            terms.append(weighted_equations(*smoothness_residual(values, held.expected)))
        return summed(terms)
