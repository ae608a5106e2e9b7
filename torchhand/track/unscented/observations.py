"""Any kind of observation in a filter: the quadratic model of its cost is a measurement with a linear prediction."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Problem, Stage
from torchhand.numerics import NormalEquations, update_extended
from torchhand.track.belief import FollowedHand, HandMotion
from torchhand.track.scene import Scene

_NEAR = Stage(gross_m=0.004)
_NOTHING = 1e-12  # of the largest information, below which a direction is not observed


def corrected_by(
    hand: FollowedHand, scene: Scene, motion: HandMotion, shape: Float[Tensor, "shape"], *, weight: float = 1.0
) -> FollowedHand:
    """The hand corrected by the scene's further observations; itself where there are none.

    weight: of their cost, such as the share of one among several passes.
    """
    problem = Problem(
        space=motion.space.about(hand.base), skeleton=motion.skeleton, shape=shape, observations=scene.observations
    )
    if problem.is_empty:
        return hand
    free = hand.belief.mean[None, : motion.space.size]
    model = problem.associated(free, hand.reference[None], _NEAR).here()
    innovation, rows = _measurement(model)
    noise = torch.full_like(innovation, 1 / weight)
    return motion.limited(replace(hand, belief=update_extended(hand.belief, innovation, rows, noise).state))


def _measurement(model: NormalEquations) -> tuple[Float[Tensor, "m"], Float[Tensor, "m free"]]:
    """Innovation and Jacobian of unit noise whose ½ |innovation - Jacobian · step|² is the model of one hand's cost.

    With the eigenvalues λ and vectors V of its matrix: √λ Vᵀ, and -Vᵀ gradient / √λ.
    """
    values, vectors = torch.linalg.eigh(model.matrix[0])
    is_seen = values > _NOTHING * values.max().clamp_min(torch.finfo(values.dtype).tiny)
    root = torch.where(is_seen, values, 0.0).sqrt()
    pull = vectors.mT @ model.gradient[0]
    return -torch.where(is_seen, pull / root, 0.0), root[:, None] * vectors.mT
