"""How a hand is fitted into a visual hull: by torques as in paper 002, or by least squares from coarse to fine."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

TorqueSteps = Literal["largest", "proportional", "equal"]


@dataclass(frozen=True, kw_only=True)
class HullTorqueSettings:
    """Steps 3 to 7 of paper 002, section 5.2. The paper prints no numbers but 20 iterations and 2010 vertices."""

    iterations: int = 20
    """Most steps; 1 or more. 20 in the paper's figures 13 and 14."""
    step_deg: float = 1.0
    """Δα by which an angle follows its torque in one step; above 0."""
    least_step_deg: float = 0.05
    """To which Δα shrinks, as it is halved where an angle's torque turns round; above 0, `step_deg` keeps it as
    printed."""
    steps: TorqueSteps = "largest"
    """Whose angles take the step, which the paper leaves open (see `fit_by_torques`).

    largest: in each digit the angle of the largest torque. proportional: the largest of all takes the whole Δα, others
    their share of it. equal: every angle with a torque takes the whole Δα. The root's coordinates move in any case.
    """
    root_step_mm: float = 1.0
    """The same as `step_deg` of the root's place, where the root is free; above 0."""
    outside_share: float = 0.002
    """Share of the vertices outside the hull below which the fit is done; 0 or more."""
    slack_m: float = 0.0
    """Distance from the hull's surface up to which a vertex counts as inside, metres; finite."""
    least_torque: float = 1e-3
    """Torque that moves no angle, over the largest that all forces could give about its joint; 0 or more, below 1."""

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"hull_torque.iterations: expected 1 or more, got {self.iterations!r}")
        for name in ("step_deg", "least_step_deg", "root_step_mm"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"hull_torque.{name}: expected above 0 and finite, got {getattr(self, name)!r}")
        if self.steps not in get_args(TorqueSteps):
            allowed = ", ".join(get_args(TorqueSteps))
            raise ValueError(f"hull_torque.steps: expected one of {allowed}, got {self.steps!r}")
        if self.least_step_deg > self.step_deg:
            raise ValueError(f"hull_torque.least_step_deg: expected at most step_deg, got {self.least_step_deg!r}")
        if not 0 <= self.outside_share < 1:
            raise ValueError(f"hull_torque.outside_share: expected 0 or more and below 1, got {self.outside_share!r}")
        if not -float("inf") < self.slack_m < float("inf"):
            raise ValueError(f"hull_torque.slack_m: expected a finite number, got {self.slack_m!r}")
        if not 0 <= self.least_torque < 1:
            raise ValueError(f"hull_torque.least_torque: expected 0 or more and below 1, got {self.least_torque!r}")


@dataclass(frozen=True, kw_only=True)
class HullLevel:
    """One step from coarse to fine."""

    robust_m: float = 0.010
    """Distance beyond which a point of the hull's surface counts as gross, metres; above 0."""
    rounds: int = 2
    """Looks at the model: which of its vertices belong to which points of the hull; 1 or more."""
    iterations: int = 3
    """Most steps of the optimiser after each look; 1 or more."""
    is_judged: bool = True
    """Whether a step is taken only if it lowers the cost. Without, there is one step after each look: twice as fast,
    and enough near the pose."""

    def __post_init__(self) -> None:
        for name in ("rounds", "iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"hull level.{name}: expected 1 or more, got {getattr(self, name)!r}")
        if not 0 < self.robust_m < float("inf"):
            raise ValueError(f"hull level.robust_m: expected above 0 and finite, got {self.robust_m!r}")


HULL_LEVELS = (
    HullLevel(robust_m=0.030, rounds=3, iterations=3),
    HullLevel(robust_m=0.012, rounds=2, iterations=3),
    HullLevel(robust_m=0.005, rounds=2, iterations=3),
    HullLevel(robust_m=0.002, rounds=2, iterations=3),
)
"""For starts that may be 30 mm and 30° off."""
HULL_TRACKING_LEVELS = (
    HullLevel(robust_m=0.008, rounds=1, iterations=1, is_judged=False),
    HullLevel(robust_m=0.003, rounds=1, iterations=1, is_judged=False),
    HullLevel(robust_m=0.002, rounds=1, iterations=1, is_judged=False),
)
"""For starts near the pose, such as a prediction."""


@dataclass(frozen=True, kw_only=True)
class HullFitSettings:
    """Coarse to fine, weights and sizes of the least-squares fit."""

    levels: tuple[HullLevel, ...] = HULL_LEVELS
    """At least one; the last one decides about cost, status and covariance."""
    vertices: int = 500
    """Vertices of the skin that must be inside the hull, spread evenly over it; 1 or more."""
    std_m: float = 0.0007
    """Standard deviation of the hull's surface, metres, at least; above 0."""
    std_share: float = 0.5
    """The same as a share of a level's robust distance; above 0."""
    inside_weight: float = 100.0
    """Independent measurements that the vertices inside are worth together; 0 or more."""
    covered_weight: float = 200.0
    """The same of the rays through the silhouettes' edges, all of which touch the hand; 0 or more. Without it, and
    without the next, a hand folded inside the hull costs nothing."""
    surface_weight: float = 25.0
    """The same of the points of the hull's surface, where the edges are not known; 0 or more. Less, for much of a
    hull's surface is no skin."""
    inside_robust: float = 3.0
    """Distance outside the hull, over a level's standard deviation, from which a vertex's cost grows linearly; above
    0."""
    slack_m: float = 0.0
    """Distance from the hull's surface up to which a vertex counts as inside, metres; finite."""
    beyond_wrist_m: float = 0.0
    """How far beyond the wrist the hull's surface must be covered, metres: 0 where a forearm may follow, more where the
    silhouettes end at the wrist, which then tells where it is. 0 or more."""
    turn_m: float = 0.012
    """Distance that a turn of the surface by one radian is worth in matching, metres; above 0."""
    constraint_weight: float = 0.2
    """Of the dynamic constraints; 0 or more. The static limits hold exactly."""
    prior_weight: float = 0.2
    """Of the posture prior, where one is given; 0 or more. What cameras do not see, such as how a finger that hides
    among others shares its turn between its joints, only the prior tells; with 1 it takes a finger that hands rarely
    bend alone for one beside another."""
    prior_tail: float = math.inf
    """Degrees of freedom of that prior as a Student's t distribution: the fewer, the less an unusual posture is pulled
    to usual ones; above 0, infinite for a normal one."""
    firmness: float = 0.0
    """How much less the skin counts that no bone carries alone, such as the webs between fingers, where people (and
    models) differ more: power of the largest share of a bone in it; 0 or more, 0 counts all alike."""
    near_m: float = 0.004
    """Distance up to which skin explains an edge of a silhouette, or is taken as inside, for the verdict, metres; above
    0."""
    least_covered: float = 0.85
    """Share of the edges that the skin must explain for a good fit; 0 to 1."""
    least_held: float = 0.95
    """Share of the skin's area that must be inside or near the hull for a good fit; 0 to 1."""
    hypotheses_at_once: int = 16
    """Hypotheses that are worked on together; bounds the memory. 1 or more."""

    def __post_init__(self) -> None:
        if not self.levels:
            raise ValueError("hull_fit.levels: expected at least one")
        for name in ("vertices", "hypotheses_at_once"):
            if getattr(self, name) < 1:
                raise ValueError(f"hull_fit.{name}: expected 1 or more, got {getattr(self, name)!r}")
        for name in ("std_m", "std_share", "inside_robust", "turn_m", "near_m"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"hull_fit.{name}: expected above 0 and finite, got {getattr(self, name)!r}")
        for name in (
            "inside_weight",
            "covered_weight",
            "surface_weight",
            "constraint_weight",
            "prior_weight",
            "beyond_wrist_m",
        ):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"hull_fit.{name}: expected 0 or more and finite, got {getattr(self, name)!r}")
        for name in ("least_covered", "least_held"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"hull_fit.{name}: expected 0 to 1, got {getattr(self, name)!r}")
        if not self.prior_tail > 0:
            raise ValueError(f"hull_fit.prior_tail: expected above 0, got {self.prior_tail!r}")
        if not -float("inf") < self.slack_m < float("inf"):
            raise ValueError(f"hull_fit.slack_m: expected a finite number, got {self.slack_m!r}")


@dataclass(frozen=True, kw_only=True)
class HullStartSettings:
    """How a hand is looked for in a hull without a guess."""

    places: int = 2
    """Most places of the palm; 1 or more."""
    rolls: int = 8
    """Turns about each of the 14 directions of the fingers; 1 or more."""
    postures: tuple[str, ...] = ("open", "flat", "fist", "point", "pinch", "victory", "three", "l", "shaka", "thumb_up")
    """Named postures; at least one."""
    vertices: int = 150
    """Vertices of the skin in the coarse fit; twice as many in the judgement before. 1 or more."""
    points: int = 150
    """Points of the hull's surface in both, where the silhouettes' edges are not known; 1 or more."""
    far_m: float = 0.03
    """Distance at which both kinds of points are cut off in the judgement, metres; above 0."""
    coarse: int = 60
    """Hypotheses of each size that are fitted coarsely; 1 or more."""
    fine: int = 5
    """Hypotheses of each size that are fitted finely; 1 or more."""
    rays: int = 200
    """Rays through the silhouettes' edges in all but the last fit; 1 or more."""
    varied: int = 2
    """Best hypotheses of each size of which single digits are tried in other postures; 1 or more."""
    finger_rounds: int = 4
    """Most rounds in which single digits are tried in other postures; 0 or more."""
    judged_at_once: int = 64
    """Hypotheses that are judged together; bounds the memory. 1 or more."""

    def __post_init__(self) -> None:
        for name in ("places", "rolls", "vertices", "points", "coarse", "fine", "rays", "varied", "judged_at_once"):
            if getattr(self, name) < 1:
                raise ValueError(f"hull_start.{name}: expected 1 or more, got {getattr(self, name)!r}")
        if self.finger_rounds < 0:
            raise ValueError(f"hull_start.finger_rounds: expected 0 or more, got {self.finger_rounds!r}")
        if not self.postures:
            raise ValueError("hull_start.postures: expected at least one")
        if not 0 < self.far_m < float("inf"):
            raise ValueError(f"hull_start.far_m: expected above 0 and finite, got {self.far_m!r}")


@dataclass(frozen=True, kw_only=True)
class HullShapeSettings:
    """How the proportions of a hand are fitted to the hulls of several frames."""

    rounds: int = 24
    """Looks at all frames: which vertices belong to which points of the hulls; 1 or more."""
    iterations: int = 3
    """Most steps of the optimiser after each look; 1 or more."""
    robust_m: tuple[float, float] = (0.010, 0.003)
    """Distance beyond which a point of a hull's surface counts as gross, at the first look and at the last, metres;
    above 0."""
    people_weight: float = 1.0
    """Of what is known of people's proportions; above 0."""

    def __post_init__(self) -> None:
        for name in ("rounds", "iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"hull_shape.{name}: expected 1 or more, got {getattr(self, name)!r}")
        if not all(0 < value < float("inf") for value in self.robust_m):
            raise ValueError(f"hull_shape.robust_m: expected above 0 and finite, got {self.robust_m!r}")
        if not 0 < self.people_weight < float("inf"):
            raise ValueError(f"hull_shape.people_weight: expected above 0 and finite, got {self.people_weight!r}")
