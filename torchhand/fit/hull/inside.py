"""The skin inside the hull that the silhouettes leave, as an observation (Ueda et al. 2003, section 5.1).

A visual hull holds the whole hand and more, so skin inside it tells nothing and skin outside is wrong. By itself this
is degenerate, for any hand folded into the hull fits; `coverage` is the other side.
"""

from dataclasses import dataclass, replace

from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import is_host
from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.fit.hull.shape_rows import shape_rows
from torchhand.fit.hull.skin import SkinPoints, WeightedVertices, bones_of, skin_at
from torchhand.fit.hull.target import HullField, HullTarget
from torchhand.fit.hull.vertices import SkinVertices
from torchhand.numerics import RobustLoss

NAME = "hull"
_GROSS = 3.0  # standard deviations outside the hull from which a vertex's cost grows linearly


@dataclass(frozen=True, kw_only=True)
class InsideObservation:
    """What the silhouettes of all views say for certain: no skin outside the hull."""

    target: HullTarget
    vertices: SkinVertices

    @property
    def is_empty(self) -> bool:
        return self.target.is_empty

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "InsideObservation":
        """This observation itself, which all hypotheses have in common."""
        return self

    def associate(self, hands: PosedHands, stage: Stage) -> "InsideFactor":
        """Where the skin is; of one hand that is not evaluated elsewhere, only what is outside counts."""
        own, s = self.vertices, self.vertices.settings
        skin = own.skin.for_shape(hands)
        beyond, _ = self.target.field.sample(skin_at(skin, hands)[:, own.index])
        index, weighted, area = own.index, own.weighted, own.area_fraction
        if stage.method == "gauss_newton" and len(hands) == 1 and is_host(beyond.device):
            outside = beyond[0] > s.slack_m
            index, area = index[outside], area[outside]
            weighted = own.skin.weighted(index)
        precision = s.precision(stage)
        return InsideFactor(
            skin=own.skin,
            field=self.target.field,
            index=index,
            vertices=weighted,
            weight=s.inside_weight * precision * area * own.rigidity[index],
            robust=RobustLoss(kind="huber", scale=_GROSS * precision**-0.5),
            slack_m=s.slack_m,
            explanation=Explained(
                name=NAME,
                view=None,
                fraction=((beyond <= s.near_m) * own.area_fraction).sum(-1),
                distance=(beyond.clamp_min(0) * own.area_fraction).sum(-1),
                inside=((beyond <= s.slack_m) * own.area_fraction).sum(-1),
            ),
        )


@dataclass(frozen=True, kw_only=True)
class InsideFactor:
    """½ Σ weight ρ(distance outside the hull), ρ of Huber; the same vertices of all hands."""

    skin: SkinPoints
    """Skin of the shape that is held fixed or, where the shape is unknown, was the start."""
    field: HullField
    index: Int[Tensor, "points"]
    vertices: WeightedVertices
    """Vertices of the skin."""
    weight: Float[Tensor, "points"]
    """Inverse variances, m⁻²."""
    robust: RobustLoss
    slack_m: float
    explanation: Explained

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the DOFs, and in the shape where it is unknown."""
        skin = self.skin.for_shape(hands)
        vertices = self.vertices if skin is self.skin else skin.weighted(self.index)
        motion = skin.motion(bones_of(skin, hands), vertices)
        value, gradient = self.field.sample(motion.points)
        beyond = (value - self.slack_m).clamp_min(0)
        direction = (beyond > 0)[..., None] * gradient
        cost, weight = self.robust.each(beyond)
        shared = None
        if hands.unknowns is not None:
            shared = shape_rows(skin, hands, self.index.expand(len(hands), -1), direction)
        return Equations.of_rows(
            beyond,
            self.weight * weight,
            motion.along(direction),
            (self.weight * cost).sum(-1),
            shared=shared,
        )

    def rows(self, rows: Int[Tensor, "n"]) -> "InsideFactor":
        """The rows of some of the hands."""
        return replace(self, explanation=self.explanation.rows(rows))

    def explained(self) -> tuple[Explained, ...]:
        """Share of the skin's area near the hull or inside, mean distance outside it, and share inside."""
        return (self.explanation,)
