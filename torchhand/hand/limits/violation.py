"""How far something is outside each of a list of constraints."""

import math
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Violation:
    """How far a pose or a shape is outside each constraint."""

    names: tuple[str, ...]
    amount: Float[Tensor, "*batch constraints"]
    """0 where the constraint holds; in radians of angles, in the measure's own unit of shapes."""
    is_angle: bool

    @property
    def worst(self) -> Float[Tensor, "*batch"]:
        """The largest."""
        return self.amount.amax(-1)

    def describe(self, tolerance: float = 1e-6) -> str:
        """The violated constraints of one pose or shape (no batch dimension), worst first; "none" if all hold.

        Angles are given in degrees.
        """
        ranked = sorted(zip(self.amount.tolist(), self.names, strict=True), key=lambda pair: -pair[0])
        broken = [(name, amount) for amount, name in ranked if not amount <= tolerance]
        texts = (f"{name} by {math.degrees(a):.1f}°" if self.is_angle else f"{name} by {a:.4f}" for name, a in broken)
        return "; ".join(texts) or "none"
