"""Losses of hands by themselves: how unlikely they are, and how far their parts are in one another."""

from jaxtyping import Float
from torch import Tensor

from torchhand.hand import HandPrior, PenetrationSettings, Primitives, penetration_penalty
from torchhand.losses.reduction import Reduction, reduced


def prior_loss(
    prior: HandPrior,
    pose: Float[Tensor, "*batch 36"],
    shape: Float[Tensor, "*#batch shape"] | None = None,
    *,
    reduction: Reduction = "mean",
) -> Float[Tensor, "*out"]:
    """How unlikely posture and proportions are, nats, up to one constant: `prior.energy`.

    Finite everywhere: beyond the limits of the joints smooth walls rise. pose: radians, in the order of DOFS; its root
    has no part in it. shape: parameters of the shape space; without one, postures alone count.
    """
    return reduced(prior.energy(pose, shape), reduction)


def penetration_loss(
    primitives: Primitives, settings: PenetrationSettings | None = None, *, reduction: Reduction = "mean"
) -> Float[Tensor, "*out"]:
    """How deep digits are in each other and in the palm: ½ Σ (depth beyond what counts as touching / softness)².

    primitives: those of posed hands, `hand(pose).primitives`. `prior_loss` contains it already.
    """
    return reduced(penetration_penalty(primitives, settings), reduction)
