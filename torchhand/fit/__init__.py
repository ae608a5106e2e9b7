"""A posed hand compared with what was seen: residuals and normal equations of priors, limits and colours."""

from torchhand.fit.appearance import (
    Agreement,
    Appearance,
    disc,
    grey,
    hand_region,
    learn_appearance,
    mask_plane,
    overlap,
    relearned,
    touching,
    unexplained_px,
)
from torchhand.fit.bounds import own_limits
from torchhand.fit.equations import summed, weighted_equations
from torchhand.fit.limits import DynamicConstraints, limit_residual
from torchhand.fit.posture import PostureResiduals
from torchhand.fit.registration_beliefs import Beliefs, HeldBeliefs
from torchhand.fit.smoothness import Expectation, smoothness_residual

__all__ = [
    "Agreement",
    "Appearance",
    "Beliefs",
    "DynamicConstraints",
    "Expectation",
    "HeldBeliefs",
    "PostureResiduals",
    "disc",
    "grey",
    "hand_region",
    "learn_appearance",
    "limit_residual",
    "mask_plane",
    "overlap",
    "own_limits",
    "relearned",
    "smoothness_residual",
    "summed",
    "touching",
    "unexplained_px",
    "weighted_equations",
]
