"""Any kind of observation in a filter, by the quadratic model of its cost."""

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Problem, Stage
from torchhand.numerics import update_quadratic
from torchhand.track.belief import FollowedHand, HandMotion
from torchhand.track.scene import Scene

_NEAR = Stage(gross_m=0.004)


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
    belief = update_quadratic(hand.belief, weight * model.gradient[0], weight * model.matrix[0])
    return motion.limited(replace(hand, belief=belief))
