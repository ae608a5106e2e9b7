"""The cost of a registration between two looks at the model: residuals of a picture's contours as normal equations."""

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit import Beliefs, HeldBeliefs
from torchhand.fit.contour.springs import PictureTerms, contour_springs
from torchhand.hand.limits import clamp_to_limits
from torchhand.image import DistanceField
from torchhand.numerics import NormalEquations
from torchhand.view import ContourLook, Contours
from torchhand.view.contours import HandContourMotion

_ROOT = 6


@dataclass(frozen=True, kw_only=True)
class LookedAt:
    """What is held between two looks; a row per hypothesis."""

    root_reference: Float[Tensor, "k 3 3"]
    look: ContourLook
    terms: PictureTerms
    beliefs: HeldBeliefs

    def rows(self, rows: Int[Tensor, "n"]) -> "LookedAt":
        """The given hypotheses."""
        if len(rows) == len(self.root_reference):
            return self
        parts = (getattr(self, name).rows(rows) for name in ("look", "terms", "beliefs"))
        look, terms, beliefs = parts
        return LookedAt(root_reference=self.root_reference[rows], look=look, terms=terms, beliefs=beliefs)


@dataclass(frozen=True, kw_only=True)
class RegistrationCost:
    """½ Σ weight ρ(residual) of all kinds; weights are inverse variances, px⁻²."""

    contours: Contours
    beliefs: Beliefs
    held: LookedAt
    field: DistanceField
    valleys: DistanceField | None

    def equations(self, values: Float[Tensor, "k free"], rows: Int[Tensor, "k"]) -> NormalEquations:
        """At free parameters of the given hypotheses, rotations about the references that are held."""
        return self._equations(values, self.held.rows(rows), None)

    def at_look(self, values: Float[Tensor, "k free"]) -> NormalEquations:
        """At the free parameters of the poses that were looked at."""
        return self._equations(values, self.held, self.held.look.motion)

    def _equations(self, values: Tensor, held: LookedAt, motion: HandContourMotion | None) -> NormalEquations:
        space = self.beliefs.space
        wanted = space.dof(values)
        pose = clamp_to_limits(wanted, self.contours.kinematics.skeleton)
        if motion is None:
            motion = self.contours.motion(pose, held.root_reference, held.look)
        springs, cost = contour_springs(motion.columns_px, self.field, self.valleys, held.terms)
        matrix, gradient = motion.equations(springs)
        of_joints = self.beliefs.of_joints(pose, held.beliefs)
        if of_joints is not None:
            matrix[:, _ROOT:, _ROOT:] += of_joints.matrix
            gradient[:, _ROOT:] += of_joints.gradient
            cost = cost + of_joints.cost
        basis = (pose == wanted)[..., None] * space.basis  # DOFs at their limits do not follow
        matrix, gradient = basis.mT @ (matrix @ basis), (gradient[:, None] @ basis).squeeze(1)
        of_free = self.beliefs.of_free(values, held.beliefs)
        if of_free is not None:
            matrix, gradient, cost = matrix + of_free.matrix, gradient + of_free.gradient, cost + of_free.cost
        return NormalEquations(matrix=matrix, gradient=gradient, cost=cost)
