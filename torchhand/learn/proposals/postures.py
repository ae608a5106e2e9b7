"""The hands that proposals are learned from: postures of the prior, signs, named postures, and mixtures of them."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, POSTURES, HandPrior, Skeleton, posture
from torchhand.signs import load_signs

_ROOT = len(DOFS) - len(JOINT_DOFS)
_SHARES = (0.45, 0.2, 0.15, 0.2)  # of the prior, of known postures, between two of them, fingers of several
_WOBBLE = 0.12  # radians: standard deviation of known postures' angles
_FINGER_OF_JOINT = [next((i for i, finger in enumerate(FINGERS) if dof.startswith(finger)), 0) for dof in JOINT_DOFS]


def drawn_hands(
    prior: HandPrior, count: int, generator: torch.Generator
) -> tuple[Float[Tensor, "count 30"], Float[Tensor, "count shape"]]:
    """Joint angles within their limits, and shapes of random people."""
    drawn, shape = prior.sample(count, generator)
    known = known_postures(prior.kinematics.skeleton).to(drawn)
    kind = torch.rand(count, generator=generator)
    mixed = _mixed(drawn[:, _ROOT:], known, generator)
    limits = torch.cumsum(torch.tensor(_SHARES), 0)
    choice = torch.searchsorted(limits, kind).clamp_max(len(_SHARES) - 1)
    joints = torch.stack((drawn[:, _ROOT:], *mixed))[choice, torch.arange(count)]
    return prior.kinematics.skeleton.within_limits(joints), shape


def known_postures(skeleton: Skeleton) -> Float[Tensor, "postures 30"]:
    """Joint angles of the named postures and of the signs."""
    named = [posture(name, dtype=torch.float64)[_ROOT:] for name in POSTURES]
    return skeleton.within_limits(torch.stack((*named, *load_signs().values())))


def _mixed(
    drawn: Float[Tensor, "count 30"], known: Float[Tensor, "postures 30"], generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Known postures that wobble, postures between two others, and hands whose fingers come from several postures."""
    count = len(drawn)

    def chosen() -> Tensor:
        """A known posture or one of the prior's."""
        some = known[torch.randint(len(known), (count,), generator=generator)]
        other = drawn[torch.randperm(count, generator=generator)]
        return torch.where(torch.rand(count, 1, generator=generator) < 0.5, some, other)

    wobble = _WOBBLE * torch.randn(count, drawn.shape[1], generator=generator)
    fixed = known[torch.randint(len(known), (count,), generator=generator)] + wobble
    between = torch.lerp(chosen(), chosen(), torch.rand(count, 1, generator=generator).to(drawn))
    one, other = chosen(), chosen()
    takes = torch.rand(count, len(FINGERS), generator=generator) < 0.4
    patched = torch.where(takes[:, _FINGER_OF_JOINT], one, other)
    return fixed, between, patched
