"""How a hand is fitted into a visual hull: by least squares from coarse to fine, or by torques (Ueda et al. 2003)."""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from torchhand.errors import require, require_positive
from torchhand.fit import Schedule, Stage

SEARCH: Schedule = (
    Stage(gross_m=0.030, rounds=3, iterations=3),
    Stage(gross_m=0.012, rounds=2, iterations=3),
    Stage(gross_m=0.005, rounds=2, iterations=3),
    Stage(gross_m=0.002, rounds=2, iterations=3),
)
"""For starts that may be 30 mm and 30° off."""
TRACKING: Schedule = (
    Stage(gross_m=0.006, rounds=1, iterations=1, method="gauss_newton"),
    Stage(gross_m=0.002, rounds=5, iterations=1, method="gauss_newton", until_arrived=True),
)
"""For starts near the pose, such as a prediction: most hands have arrived after one step of the last stage."""

_STD_FRACTION = 0.5  # standard deviation of the hull's surface over a stage's gross distance
_SHAPE_STEPS = 2  # of the optimiser at most, after each association of all frames' data in the fit of the proportions

TorqueSteps = Literal["largest", "proportional", "equal"]


def _require_count(prefix: str, settings: object, *names: str) -> None:
    for name in names:
        value = getattr(settings, name)
        require(value >= 1, f"{prefix}.{name}", "1 or more", value)


def _require_weight(name: str, value: float) -> None:
    require(0 <= value < math.inf, name, "0 or more and finite", value)


@dataclass(frozen=True, kw_only=True)
class HullSettings:
    """Weights and sizes of hull and silhouette edges."""

    vertices: int = 500
    """Vertices of the skin that must be inside the hull, spread evenly over it; 1 or more."""
    std_m: float = 0.0007
    """Smallest standard deviation of the hull's surface, metres; above 0."""
    inside_weight: float = 100.0
    """Independent measurements that the vertices inside are worth together; 0 or more."""
    edge_weight: float = 200.0
    """Independent measurements that the rays through the silhouettes' edges, all of which touch the hand, are worth
    together; 0 or more. Without them, and without the hull's surface, a hand folded inside the hull costs nothing."""
    surface_weight: float = 25.0
    """Independent measurements that points of the hull's surface are worth, where the edges are not known; 0 or more.
    Less than edges, for much of a hull's surface is no skin."""
    slack_m: float = 0.0
    """Distance from the hull's surface up to which a vertex counts as inside, metres; finite."""
    beyond_wrist_m: float = 0.0
    """How far beyond the wrist the silhouettes must be covered, metres: 0 where a forearm may follow, more where the
    silhouettes end at the wrist, which then tells where it is. 0 or more."""
    rigidity_exponent: float = 0.0
    """How much less the skin counts that no bone carries alone, such as the webs between fingers, where people (and
    models) differ more: power of its largest skinning weight; 0 or more, 0 counts all alike."""
    near_m: float = 0.004
    """Distance up to which skin explains an edge of a silhouette, or is taken as inside, for the verdict, metres; above
    0."""

    def __post_init__(self) -> None:
        _require_count("hull", self, "vertices")
        for name in ("std_m", "near_m"):
            require_positive(f"hull.{name}", getattr(self, name))
        for name in ("inside_weight", "edge_weight", "surface_weight", "beyond_wrist_m", "rigidity_exponent"):
            _require_weight(f"hull.{name}", getattr(self, name))
        require(math.isfinite(self.slack_m), "hull.slack_m", "a finite number", self.slack_m)

    def precision(self, stage: Stage) -> float:
        """Inverse variance of the hull's surface in a stage, m⁻²: coarse ones leave more to the priors."""
        return max(self.std_m, _STD_FRACTION * stage.gross_m) ** -2


@dataclass(frozen=True, kw_only=True)
class JointPriorWeights:
    """How much is believed of joint angles beside the silhouettes. The static limits hold exactly in any case."""

    constraints: float = 0.2
    """Weight of the constraints between joint angles; 0 or more."""
    postures: float = 0.2
    """Weight of the likely postures; 0 or more. What cameras do not see, such as how a finger that hides among others
    shares its turn between its joints, only they tell; with 1 a finger that hands rarely bend alone is taken for one
    beside another."""
    penetration: float = 1.0
    """Weight of digits in one another; 0 or more."""
    posture_tail: float = math.inf
    """Degrees of freedom of the postures' Student's t distribution: the fewer, the less an unusual posture is pulled to
    usual ones; above 0, infinite for a normal one."""

    def __post_init__(self) -> None:
        for name in ("constraints", "postures", "penetration"):
            _require_weight(f"joints.{name}", getattr(self, name))
        require(self.posture_tail > 0, "joints.posture_tail", "above 0", self.posture_tail)


@dataclass(frozen=True, kw_only=True)
class HullTorqueSettings:
    """Steps 3 to 7 of Ueda et al. 2003, section 5.2, which prints no numbers but 20 iterations and 2010 vertices."""

    iterations: int = 20
    """Largest number of steps; 1 or more. 20 in figures 13 and 14."""
    step_deg: float = 1.0
    """Δα by which an angle follows its torque in one step; above 0."""
    min_step_deg: float = 0.05
    """Step to which Δα shrinks, as it is halved where an angle's torque turns round; above 0, `step_deg` keeps it as
    printed."""
    steps: TorqueSteps = "largest"
    """Angles that take the step, which Ueda et al. (2003) leave open (see `fit_by_torques`). largest: in each digit the
    angle of the largest torque. proportional: the largest of all takes the whole Δα, others their share of it. equal:
    every angle with a torque takes the whole Δα. The root's coordinates move in any case."""
    root_step_mm: float = 1.0
    """Distance by which the root follows its force in one step, where it is free; above 0."""
    outside_fraction: float = 0.002
    """Share of the vertices outside the hull below which the fit is done; 0 or more."""
    slack_m: float = 0.0
    """Distance from the hull's surface up to which a vertex counts as inside, metres; finite."""
    min_torque: float = 1e-3
    """Torque that moves no angle, over the largest that all forces could give about its joint; 0 or more, below 1."""

    def __post_init__(self) -> None:
        _require_count("hull_torque", self, "iterations")
        for name in ("step_deg", "min_step_deg", "root_step_mm"):
            require_positive(f"hull_torque.{name}", getattr(self, name))
        steps = get_args(TorqueSteps)
        require(self.steps in steps, "hull_torque.steps", f"one of {', '.join(steps)}", self.steps)
        require(self.min_step_deg <= self.step_deg, "hull_torque.min_step_deg", "at most step_deg", self.min_step_deg)
        for name in ("outside_fraction", "min_torque"):
            value = getattr(self, name)
            require(0 <= value < 1, f"hull_torque.{name}", "0 or more and below 1", value)
        require(math.isfinite(self.slack_m), "hull_torque.slack_m", "a finite number", self.slack_m)


@dataclass(frozen=True, kw_only=True)
class HullStartSettings:
    """How a hand is looked for in a hull without a guess."""

    places: int = 2
    """Largest number of places of the palm; 1 or more."""
    rolls: int = 8
    """Turns about each of the 14 directions of the fingers; 1 or more."""
    postures: tuple[str, ...] = ("open", "flat", "fist", "point", "pinch", "victory", "three", "l", "shaka", "thumb_up")
    """Named postures; at least one."""
    vertices: int = 150
    """Vertices of the skin in the coarse fit; twice as many in the evaluation before. 1 or more."""
    points: int = 150
    """Points of the hull's surface in both, where the silhouettes' edges are not known; 1 or more."""
    coarse: int = 60
    """Hypotheses of each size that are fitted coarsely; 1 or more."""
    fine: int = 5
    """Hypotheses of each size that are fitted finely; 1 or more."""
    rays: int = 200
    """Rays through the silhouettes' edges in all but the last fit; 1 or more."""
    finger_hypotheses: int = 2
    """Best hypotheses of each size of which single digits are tried in other postures; 1 or more."""
    finger_rounds: int = 4
    """Largest number of rounds in which single digits are tried in other postures; 0 or more."""
    proposed: int = 16
    """Hypotheses that are fitted of those that are proposed to a search; 1 or more."""
    proposed_finger_rounds: int = 1
    """Rounds in which single digits of the best of these are tried in other postures; 0 or more."""

    def reduced(self) -> "HullStartSettings":
        """Half the hypotheses, and further fingers of the best of them in one round alone."""
        coarse, fine = max(1, self.coarse // 2), max(1, (self.fine + 1) // 2)
        rounds = min(1, self.finger_rounds)
        return replace(self, coarse=coarse, fine=fine, finger_hypotheses=1, finger_rounds=rounds)

    def __post_init__(self) -> None:
        counts = ("places", "rolls", "vertices", "points", "coarse", "fine", "rays", "finger_hypotheses")
        _require_count("hull_start", self, *counts, "proposed")
        for name in ("finger_rounds", "proposed_finger_rounds"):
            require(getattr(self, name) >= 0, f"hull_start.{name}", "0 or more", getattr(self, name))
        require(len(self.postures) > 0, "hull_start.postures", "at least one", self.postures)


@dataclass(frozen=True, kw_only=True)
class HullShapeSettings:
    """How the proportions of a hand are fitted to the hulls of several frames."""

    rounds: int = 6
    """Associations of all frames' data with the posed hands; 1 or more."""
    gross_m: tuple[float, float] = (0.010, 0.003)
    """Distance beyond which a residual counts as gross, in the first round and in the last, metres; above 0."""

    def __post_init__(self) -> None:
        _require_count("hull_shape", self, "rounds")
        for value in self.gross_m:
            require_positive("hull_shape.gross_m", value)

    @property
    def schedule(self) -> Schedule:
        """One round after the other, the gross distance shrinking by the same factor."""
        first, last = self.gross_m
        fractions = (turn / max(1, self.rounds - 1) for turn in range(self.rounds))
        return tuple(
            Stage(gross_m=first * (last / first) ** fraction, rounds=1, iterations=_SHAPE_STEPS)
            for fraction in fractions
        )
