"""How freely a hand moves, and what is believed of its posture while it is followed."""

import math
from dataclasses import dataclass

from torchhand.errors import require, require_positive


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """How freely the hand moves: roots of the spectral densities that drive the motion model, one per kind of DOF.

    In (unit) / s^(order + 1/2): with order 2, m s⁻²·⁵ and rad s⁻²·⁵; with order 0, m s⁻⁰·⁵ and rad s⁻⁰·⁵.
    """

    translation: float = 30.0
    """Translations of the root; 0 or more."""
    rotation: float = 150.0
    """Rotations of the root; 0 or more."""
    angle: float = 300.0
    """Joint angles; 0 or more."""

    def __post_init__(self) -> None:
        for name in ("translation", "rotation", "angle"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"noise.{name}", "0 or more and finite", value)


@dataclass(frozen=True, kw_only=True)
class PosturePriorSettings:
    """A weak posture prior, used as measurements at every frame where fingers are free."""

    rest_std_rad: float = 1.0
    """Standard deviation of joint angles about those of the start; above 0."""
    tie_std_rad: float = 0.25
    """Standard deviation of the end joint's flexion about two thirds of that of the middle joint (Ouhaddi and Horain
    1998, eq. 1); above 0."""
    tilt_std_rad: float = 0.6
    """Standard deviation of the rotation out of the picture's plane since the start; above 0. Of one camera only."""

    def __post_init__(self) -> None:
        for name in ("rest_std_rad", "tie_std_rad", "tilt_std_rad"):
            require_positive(f"prior.{name}", getattr(self, name))
