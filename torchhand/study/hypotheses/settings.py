"""Settings of the hypothesis study, and what follows from them."""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from torchhand.errors import require, require_positive
from torchhand.fit import Schedule
from torchhand.fit.contour import THIN_SEARCH, ContourSettings, RestartSettings
from torchhand.hand import POSE_SPACES
from torchhand.study import PerturbationSettings

SurfaceName = Literal["primitives", "mesh"]
STUDY_SPACES = tuple(name for name, (free, _) in POSE_SPACES.items() if any(not dof.startswith("root") for dof in free))
"""Pose spaces with joint angles to recover."""

_GAP_M = 0.0005
"""Beyond one pixel, how broad a gap between two fingers is at least: masks of simulated pictures are exact, and show
narrower ones than those of skin colour, on whose contour a finger beside another would have no place."""
_EXACT_PX = 1.0
"""Standard deviation of the contours of exact masks: what their pixels and the model's points leave."""
_BOUNDARY_POINTS = 512
"""Points of the picture's contour: every 3 px or so, at which a fingertip that shows by a few pixels has some."""
_MAX_STARTS, _MAX_AT_ONCE = 10_000_000, 4096


@dataclass(frozen=True, kw_only=True)
class HypothesisStudySettings:
    """Starts, registration, and what counts as success."""

    starts: int = 10_000
    """Starts of all pictures together, shared out evenly; 1 to 10,000,000."""
    batch: int = 512
    """Starts that are registered together: bounds the memory. Other batches draw other starts. 1 to 4096."""
    perturbation: PerturbationSettings = field(default_factory=PerturbationSettings)
    precision: Literal["single", "double"] = "single"
    """Numbers that registration computes with; errors are always told from doubles."""
    space: str = "dof26"
    """Pose space, through the reference pose: what it ties or holds is as in the reference."""
    surface: SurfaceName = "primitives"
    """Surface whose contours are registered: those of the quadrics, or those of the skinned mesh."""
    points_per_generator: int = 12
    """Outline points on each side of a cone; 2 or more."""
    points_per_arc: int = 8
    """Outline points on each ellipsoid; 4 or more."""
    mesh_points: int = 500
    """Most points of the mesh's contours; 50 or more."""
    has_prior: bool = True
    """The registration knows which postures are likely."""
    has_start_prior: bool = True
    """The registration knows how far starts may be off: normal errors with the spread of the largest perturbation, as a
    tracker's prediction has."""
    success_deg: float = 5.0
    """Largest mean error of the joint angles of a success; above 0."""
    best_of: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Numbers of starts of which that with the least misfit is evaluated; increasing, 1 or more."""
    schedule: Schedule = THIN_SEARCH
    """Registration from coarse to fine; at least one stage."""
    restarts: RestartSettings = field(default_factory=RestartSettings)
    """Hands that explain too little of the contour are registered from beside themselves as well."""
    contour: ContourSettings = field(
        default_factory=lambda: ContourSettings(
            by_length=True, probe_distance_m=_GAP_M, contour_std_px=_EXACT_PX, boundary_points=_BOUNDARY_POINTS
        )
    )
    """Weights and tolerances of the contours in a picture."""

    def __post_init__(self) -> None:
        for name, maximum in (("starts", _MAX_STARTS), ("batch", _MAX_AT_ONCE)):
            require(1 <= getattr(self, name) <= maximum, name, f"1 to {maximum}", getattr(self, name))
        for name, minimum in (("points_per_generator", 2), ("points_per_arc", 4), ("mesh_points", 50)):
            require(getattr(self, name) >= minimum, name, f"{minimum} or more", getattr(self, name))
        require(self.space in STUDY_SPACES, "space", f"one of {', '.join(STUDY_SPACES)}", self.space)
        require(
            self.surface in get_args(SurfaceName), "surface", f"one of {', '.join(get_args(SurfaceName))}", self.surface
        )
        require_positive("success_deg", self.success_deg)
        is_increasing = bool(self.best_of) and list(self.best_of) == sorted(set(self.best_of)) and self.best_of[0] >= 1
        require(is_increasing, "best_of", "increasing whole numbers from 1 on", self.best_of)
        require(bool(self.schedule), "schedule", "at least one stage", self.schedule)


def total_iterations(schedule: Schedule) -> int:
    """Most iterations of one hypothesis over all stages and associations."""
    return sum(stage.rounds * stage.iterations for stage in schedule)


def with_iterations(schedule: Schedule, total: int) -> Schedule:
    """The stages with their iterations scaled so that there are at most so many in all, and hardly fewer.

    Raises ValueError for fewer than one per association.
    """
    rounds, whole = sum(stage.rounds for stage in schedule), total_iterations(schedule)
    if total < rounds:
        raise ValueError(f"iterations: expected {rounds} or more, one for each round of the schedule, got {total}")
    scaled = [replace(stage, iterations=max(1, stage.iterations * total // whole)) for stage in schedule]
    for i in sorted(range(len(schedule)), key=lambda i: -(schedule[i].iterations * total % whole)):
        left = total - total_iterations(tuple(scaled))
        if left >= scaled[i].rounds:
            scaled[i] = replace(scaled[i], iterations=scaled[i].iterations + 1)
    while total_iterations(tuple(scaled)) > total:  # where the one iteration that every round needs was too many
        i = max(range(len(scaled)), key=lambda i: scaled[i].iterations)
        scaled[i] = replace(scaled[i], iterations=scaled[i].iterations - 1)
    return tuple(scaled)
