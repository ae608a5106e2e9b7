"""The cost of a fit into a hull between two looks at the model, as normal equations."""

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit import Beliefs, HeldBeliefs, summed, weighted_equations
from torchhand.fit.hull.covered import hull_covered_residual
from torchhand.fit.hull.inside import hull_inside_residual
from torchhand.fit.hull.points import HullTarget
from torchhand.fit.hull.skin import PosedBones, SkinLoads, SkinPoints
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import NormalEquations, RobustLoss

_ROOT = 6


@dataclass(frozen=True, kw_only=True)
class HeldHull:
    """What is held between two looks; a row per hypothesis."""

    root_reference: Float[Tensor, "k 3 3"]
    match: SkinLoads
    """The vertex of each point of the hull's surface."""
    points: Float[Tensor, "hull 3"]
    """Points of the hull's surface, or of rays that touch the hand."""
    normals: Float[Tensor, "k hull 3"]
    """Of those vertices, at the look, or of the rays."""
    covered_weight: Float[Tensor, "k hull"]
    beliefs: HeldBeliefs

    def rows(self, rows: Int[Tensor, "n"]) -> "HeldHull":
        """The given hypotheses."""
        if len(rows) == len(self.root_reference):
            return self
        return HeldHull(
            root_reference=self.root_reference[rows],
            match=self.match.rows(rows),
            points=self.points,
            normals=self.normals[rows],
            covered_weight=self.covered_weight[rows],
            beliefs=self.beliefs.rows(rows),
        )


@dataclass(frozen=True, kw_only=True)
class HullCost:
    """½ Σ weight ρ(residual) of all kinds; weights are inverse variances, m⁻²."""

    skin: SkinPoints
    beliefs: Beliefs
    held: HeldHull
    target: HullTarget
    inside: SkinLoads
    """Vertices that must be inside."""
    inside_weight: Float[Tensor, "points"]
    inside_robust: RobustLoss
    covered_robust: RobustLoss
    slack_m: float

    def equations(
        self, values: Float[Tensor, "k free"], rows: Int[Tensor, "k"], bones: PosedBones | None = None
    ) -> NormalEquations:
        """At free parameters of the given hypotheses, rotations about the references that are held.

        bones: there, if they are known.
        """
        held = self.held.rows(rows)
        wanted = self.beliefs.space.dof(values)
        pose = clamp_to_limits(wanted, self.skin.hand.kinematics.skeleton)
        moving = pose == wanted
        near = self.skin.shape
        bones = bones or self.skin.posed(pose.to(near), held.root_reference.to(near))
        inside, covered = self.skin.motions(bones, (self.inside, held.match), moving)
        terms = [
            weighted_equations(
                *hull_inside_residual(inside, self.target.field, slack=self.slack_m),
                self.inside_weight,
                self.inside_robust,
            ),
            weighted_equations(
                *hull_covered_residual(covered, held.points, held.normals),
                held.covered_weight,
                self.covered_robust,
            ),
        ]
        terms = [_like(term, values) for term in terms]
        of_joints = self.beliefs.of_joints(pose, held.beliefs)
        if of_joints is not None:
            terms.append(_along(of_joints, moving[:, _ROOT:, None] * self.beliefs.space.basis[_ROOT:]))
        of_free = self.beliefs.of_free(values, held.beliefs)
        return summed(terms if of_free is None else [*terms, of_free])


def _along(term: NormalEquations, basis: Float[Tensor, "k 30 free"]) -> NormalEquations:
    """Equations in the joint angles as equations in the free parameters."""
    return NormalEquations(
        matrix=basis.mT @ term.matrix @ basis,
        gradient=(term.gradient[:, None] @ basis).squeeze(1),
        cost=term.cost,
    )


def _like(term: NormalEquations, values: Tensor) -> NormalEquations:
    return NormalEquations(matrix=term.matrix.to(values), gradient=term.gradient.to(values), cost=term.cost.to(values))
