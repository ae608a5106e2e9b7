"""The 21 anthropometric constraints of Ouhaddi and Horain (1998, section 3.1): sizes of fingers, phalanges and palm as
fractions of hand length.

The paper names their classes only; five finger lengths, fourteen phalanx lengths and two palm dimensions are 21.
Published: the phalanx means (Buchholz, Armstrong and Goldstein 1992), and means and spreads of palm length and hand
breadth over hand length (ANSUR II). Chosen here: the spread of finger and phalanx lengths over people, 5 % of fingers
and long segments and 8 % of middle and distal phalanges (inside the 5 to 15 % of bone lengths in Buryanov and Kotiuk
2010; the ±0.003 of Ouhaddi and Horain is a regression's error), and that an interval reaches two spreads to either
side.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand.kinematics import FINGERS, ShapeSpace
from torchhand.hand.limits.violation import Violation
from torchhand.numerics import Polytope, polytope
from torchhand.precision import own_precision, require_exact

_PHALANX_MEANS = {  # Buchholz, Armstrong and Goldstein 1992
    "thumb": {"proximal": 0.196, "distal": 0.158},
    "index": {"proximal": 0.245, "middle": 0.143, "distal": 0.097},
    "middle": {"proximal": 0.266, "middle": 0.170, "distal": 0.108},
    "ring": {"proximal": 0.244, "middle": 0.165, "distal": 0.107},
    "little": {"proximal": 0.204, "middle": 0.117, "distal": 0.093},
}
_PALM_LENGTH = (0.602, 0.020)  # men 0.603 ± 0.020, women 0.601 ± 0.019
# Men 0.457 ± 0.021, women 0.432 ± 0.021: half of each has the mean 0.4445 and the spread √(0.021² + 0.0125²).
_PALM_BREADTH = (0.4445, 0.0244)
_CREASE = 0.016
"""From the web between the fingers to the crease at the root of the middle finger, where ANSUR's palm ends: share of
hand length (3 mm); chosen so that the default shape has the published mean."""

MEASURES = (
    *(f"{finger}_length" for finger in FINGERS),
    *(f"{finger}_{bone}" for finger in FINGERS for bone in _PHALANX_MEANS[finger]),
    *("palm_length", "palm_breadth"),
)
"""The 21 measures, all divided by hand length."""


@dataclass(frozen=True, kw_only=True)
class AnthropometrySettings:
    """Widths of the 21 intervals."""

    reach: float = 2.0
    """Half width of an interval in spreads; above 0."""
    long_spread: float = 0.05
    """Spread of finger lengths and proximal phalanges over their means; above 0."""
    short_spread: float = 0.08
    """Spread of middle and distal phalanges, the thumb's too, over their means; above 0."""
    softness: float = 0.25
    """Violation that costs ½ in the penalty, in spreads of what is violated; above 0."""
    length_breadth_correlation: float = 0.715
    """Correlation of hand length and hand breadth over people, -1 to 1. 0.58 among men and 0.57 among women (ANSUR II);
    with the difference between the sexes, which the shape space's spreads hold, 0.715, and only that gives the
    published spread of breadth over length."""

    def __post_init__(self) -> None:
        for name in ("reach", "long_spread", "short_spread", "softness"):
            if not 0 < (value := getattr(self, name)) < math.inf:
                raise ValueError(f"{name}: expected above 0 and finite, got {value!r}")
        if not -1 < self.length_breadth_correlation < 1:
            raise ValueError(
                f"length_breadth_correlation: expected between -1 and 1, got {self.length_breadth_correlation!r}"
            )


class Anthropometry:
    """The feasible set of the shape vector: the bounds of its parameters and the 21 intervals.

    All are linear inequalities, matrix · shape <= bound, of separate groups of parameters, so the projection is exact.
    Constants follow the shape's device and dtype. Immutable. A NaN stays NaN, with the parameters of its group.
    """

    def __init__(self, space: ShapeSpace, settings: AnthropometrySettings | None = None) -> None:
        self.settings = settings or AnthropometrySettings()
        self.space = space.to(dtype=torch.float64, device="cpu")
        for name in MEASURES[5:-2] + ("middle_metacarpal", "web_length"):
            if name not in space.names or space.units[space.names.index(name)] != "/HL":
                raise ValueError(f"shape space: expected a parameter {name!r} in shares of hand length (/HL)")
        self.mean, self.spread = (torch.tensor(x, dtype=torch.float64) for x in _statistics(self.settings))
        """Of MEASURES."""
        self.lower = self.mean - self.settings.reach * self.spread
        """Lower ends of the 21 intervals."""
        self.upper = self.mean + self.settings.reach * self.spread
        count = len(space.names)
        identity = torch.eye(count, dtype=torch.float64)
        rows, offset = _rows(self.space, self.lower, self.upper)
        self.matrix: Float[Tensor, "rows shape"] = torch.cat((-identity, identity, rows))
        """Linear inequalities: lower bounds, upper bounds, lower ends of the intervals, upper ends."""
        self.bound: Float[Tensor, "rows"] = torch.cat((-self.space.lower, self.space.upper, offset))
        # a row's own spread: what a violation is measured in
        breadth_spread = self.spread.clone()
        breadth_spread[-1] *= self.space.default[space.names.index("hand_length")]
        self._scale = torch.cat((self.space.std, self.space.std, breadth_spread, breadth_spread))
        self._blocks = [self._block(names) for names in _groups()]

    @own_precision
    def measures(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch 21"]:
        """The measures of a shape, without unit, in the order of MEASURES; differentiable."""
        self.space.check_width(shape)
        metric = self.space.metric(shape)
        length = metric["hand_length"]
        phalanges = [metric[name] for name in MEASURES[5:-2]]
        sums = [
            torch.stack([metric[f"{finger}_{bone}"] for bone in _PHALANX_MEANS[finger]]).sum(0) for finger in FINGERS
        ]
        palm = metric["middle_metacarpal"] + metric["web_length"] + _CREASE * length
        return torch.stack((*sums, *phalanges, palm, metric["hand_breadth"]), -1) / length[..., None]

    @own_precision
    def project(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch shape"]:
        """The nearest feasible shape, distances counted in the parameters' spreads; feasible ones come back unchanged.

        Differentiable almost everywhere.
        """
        self.space.check_width(shape)
        parameters = list(shape.clamp(self.space.lower.to(shape), self.space.upper.to(shape)).unbind(-1))
        for index, std, body in self._blocks:
            scale = std.to(shape)
            near = body.nearest(shape[..., index] / scale) * scale
            # division and multiplication may lose the last bit: a group that is feasible is kept as it was
            is_inside = (body.excess(shape[..., index] / scale) <= 1e-12).all(-1, keepdim=True)
            for place, value in zip(index, torch.where(is_inside, shape[..., index], near).unbind(-1), strict=True):
                low, high = (float(limit[place]) for limit in (self.space.lower, self.space.upper))
                parameters[place] = value.clamp(low, high)
        return torch.stack(parameters, -1)

    @own_precision
    def violation(self, shape: Float[Tensor, "*batch shape"]) -> Violation:
        """How far parameters are outside their bounds (in their own units), and measures outside their intervals."""
        self.space.check_width(shape)
        lower, upper = self.space.lower.to(shape), self.space.upper.to(shape)
        bounds = torch.maximum(lower - shape, shape - upper)
        measures = self.measures(shape)
        intervals = torch.maximum(self.lower.to(shape) - measures, measures - self.upper.to(shape))
        names = (*(f"bounds of {name}" for name in self.space.names), *(f"interval of {name}" for name in MEASURES))
        return Violation(names=names, amount=torch.cat((bounds, intervals), -1).clamp_min(0), is_angle=False)

    @own_precision
    def is_feasible(self, shape: Float[Tensor, "*batch shape"], tolerance: float = 1e-6) -> Bool[Tensor, "*batch"]:
        """Whether nothing is violated by more than the tolerance; never with NaN parameters."""
        return self.violation(shape).worst <= tolerance

    @own_precision
    def penalty(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
        """½ Σ (violation / (softness · spread))²; continuously differentiable, zero on the feasible set."""
        self.space.check_width(shape)
        excess = (shape @ self.matrix.to(shape).T - self.bound.to(shape)).clamp_min(0)
        return 0.5 * (excess / (self.settings.softness * self._scale.to(shape))).square().sum(-1)

    @own_precision
    def log_density(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
        """Log density of the normal distribution over people, not yet cut off at the constraints.

        Mean and spread of every parameter are the shape space's; hand length and breadth are correlated.
        """
        self.space.check_width(shape)
        scaled = (shape - self.space.default.to(shape)) / self.space.std.to(shape)
        length, breadth = (scaled[..., self.space.names.index(name)] for name in ("hand_length", "hand_breadth"))
        rho = self.settings.length_breadth_correlation
        square = scaled.square().sum(-1) - breadth.square() + (breadth - rho * length).square() / (1 - rho * rho)
        constant = 0.5 * len(self.space.names) * math.log(2 * math.pi) + 0.5 * math.log(1 - rho * rho)
        return -0.5 * square - constant - float(self.space.std.log().sum())

    @own_precision
    def log_prob(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
        """`log_density` on the feasible set, minus infinity outside.

        The mass that is cut off is one constant, which is left out. The gradient inside is finite.
        """
        return torch.where(self.is_feasible(shape), self.log_density(shape), -torch.inf)

    def sample(
        self, count: int, generator: torch.Generator, *, dtype: torch.dtype = torch.float32
    ) -> Float[Tensor, "count shape"]:
        """Shapes of random people with density ∝ exp(log_prob): normal ones, infeasible ones redrawn.

        Drawn in float64 on the CPU, given in `dtype`. The generator is one of the CPU; the same seed gives the same
        shapes bit for bit.
        """
        require_exact("dtype", dtype)
        if count < 0:
            raise ValueError(f"count: expected 0 or more, got {count}")
        space, size = self.space, len(self.space.names)
        length, breadth = (space.names.index(name) for name in ("hand_length", "hand_breadth"))
        rho = self.settings.length_breadth_correlation
        drawn = torch.empty(count, size, dtype=torch.float64)
        # groups are independent, so each is redrawn by itself
        groups = [index for index, _, _ in self._blocks]
        single = set(range(size)) - {place for index in groups for place in index}
        for index in (*groups, *([place] for place in sorted(single))):
            missing = torch.arange(count)
            while len(missing):
                noise = torch.randn(len(missing), len(index), generator=generator, dtype=torch.float64)
                if length in index:
                    tall, wide = index.index(length), index.index(breadth)
                    noise[:, wide] = rho * noise[:, tall] + math.sqrt(1 - rho * rho) * noise[:, wide]
                drawn[missing[:, None], index] = space.default[index] + space.std[index] * noise
                rows = self.matrix[:, index].abs().sum(-1) > 0
                excess = drawn[missing][:, index] @ self.matrix[rows][:, index].T - self.bound[rows]
                missing = missing[(excess > 0).any(-1)]
        return drawn.to(dtype)

    def _block(self, names: tuple[str, ...]) -> tuple[list[int], Tensor, Polytope]:
        """Places of a group of parameters, their spreads, and their polytope in spreads."""
        index = [self.space.names.index(name) for name in names]
        std = self.space.std[index]
        rows = self.matrix[2 * len(self.space.names) :, index]
        rows_used = rows.abs().sum(-1) > 0
        body = polytope(
            self.space.lower[index] / std,
            self.space.upper[index] / std,
            rows[rows_used] * std,
            self.bound[2 * len(self.space.names) :][rows_used],
        )
        return index, std, body


def _statistics(settings: AnthropometrySettings) -> tuple[list[float], list[float]]:
    """Mean and spread of MEASURES."""
    long, short = settings.long_spread, settings.short_spread
    means = [sum(_PHALANX_MEANS[finger].values()) for finger in FINGERS]
    spreads = [long * mean for mean in means]
    for finger in FINGERS:
        for bone, mean in _PHALANX_MEANS[finger].items():
            means.append(mean)
            spreads.append((long if bone == "proximal" else short) * mean)
    for mean, spread in (_PALM_LENGTH, _PALM_BREADTH):
        means.append(mean)
        spreads.append(spread)
    return means, spreads


def _groups() -> list[tuple[str, ...]]:
    """Parameters that constraints bind together."""
    fingers = [tuple(f"{finger}_{bone}" for bone in _PHALANX_MEANS[finger]) for finger in FINGERS]
    return [*fingers, ("middle_metacarpal", "web_length"), ("hand_length", "hand_breadth")]


def _rows(space: ShapeSpace, lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor]:
    """The intervals as rows · shape <= bound: the lower ends, then the upper ones."""
    rows = torch.zeros(2, len(MEASURES), len(space.names), dtype=torch.float64)
    bound = torch.stack((-lower, upper))
    sign = torch.tensor((-1.0, 1.0), dtype=torch.float64)

    def put(measure: str, *names: str) -> None:
        for name in names:
            rows[:, MEASURES.index(measure), space.names.index(name)] = sign

    for finger in FINGERS:
        bones = [f"{finger}_{bone}" for bone in _PHALANX_MEANS[finger]]
        put(f"{finger}_length", *bones)
        for bone in bones:
            put(bone, bone)
    put("palm_length", "middle_metacarpal", "web_length")
    palm = MEASURES.index("palm_length")
    bound[:, palm] -= sign * _CREASE
    put("palm_breadth", "hand_breadth")
    breadth = MEASURES.index("palm_breadth")
    rows[:, breadth, space.names.index("hand_length")] = -sign * torch.stack((lower, upper))[:, breadth]
    bound[:, breadth] = 0.0
    return rows.flatten(0, 1), bound.flatten()
