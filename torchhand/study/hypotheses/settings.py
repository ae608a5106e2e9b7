"""Settings of the hypothesis study, and what follows from them."""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from torchhand.fit.contour import RegistrationLevel, RegistrationSettings
from torchhand.hand import POSE_SPACES
from torchhand.study import PerturbationSettings

SurfaceName = Literal["primitives", "mesh"]
STUDY_SPACES = tuple(name for name, (free, _) in POSE_SPACES.items() if any(not dof.startswith("root") for dof in free))
"""Pose spaces with joint angles to recover."""

_MOST_STARTS, _MOST_AT_ONCE = 10_000_000, 4096


@dataclass(frozen=True, kw_only=True)
class HypothesisStudySettings:
    """Starts, registration, and what counts as success."""

    starts: int = 10_000
    """Of all pictures together, shared out evenly; 1 to 10,000,000."""
    batch: int = 128
    """Starts that are registered together: bounds the memory. Other batches draw other starts. 1 to 4096."""
    perturbation: PerturbationSettings = field(default_factory=PerturbationSettings)
    space: str = "dof26"
    """Pose space, through the reference pose: what it ties or holds is as in the reference."""
    surface: SurfaceName = "primitives"
    """Whose contours are registered: those of the quadrics, or those of the skinned mesh."""
    points_per_generator: int = 12
    """Of the primitives' contours; 2 or more."""
    points_per_arc: int = 8
    """The same; 4 or more."""
    mesh_points: int = 500
    """Most points of the mesh's contours; 50 or more."""
    has_prior: bool = True
    """The registration knows which postures are likely."""
    has_expectation: bool = True
    """The registration knows how far starts may be off: normal errors with the spread of the largest perturbation, as a
    tracker's prediction has."""
    success_deg: float = 5.0
    """Largest mean error of the joint angles of a success; above 0."""
    best_of: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Numbers of starts of which the cheapest is judged; increasing, 1 or more."""
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    """Its hypotheses_at_once is that of `batch`."""

    def __post_init__(self) -> None:
        for name, least, most in (("starts", 1, _MOST_STARTS), ("batch", 1, _MOST_AT_ONCE)):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name}: expected {least} to {most}, got {getattr(self, name)!r}")
        for name, least in (("points_per_generator", 2), ("points_per_arc", 4), ("mesh_points", 50)):
            if getattr(self, name) < least:
                raise ValueError(f"{name}: expected {least} or more, got {getattr(self, name)!r}")
        if self.space not in STUDY_SPACES:
            raise ValueError(f"space: expected one of {', '.join(STUDY_SPACES)}, got {self.space!r}")
        if self.surface not in get_args(SurfaceName):
            raise ValueError(f"surface: expected one of {', '.join(get_args(SurfaceName))}, got {self.surface!r}")
        if not 0 < self.success_deg < float("inf"):
            raise ValueError(f"success_deg: expected above 0 and finite, got {self.success_deg!r}")
        if not self.best_of or self.best_of[0] < 1 or list(self.best_of) != sorted(set(self.best_of)):
            raise ValueError(f"best_of: expected increasing whole numbers from 1 on, got {self.best_of!r}")

    @property
    def engine(self) -> RegistrationSettings:
        """Those of the registration, a batch at once."""
        return replace(self.registration, hypotheses_at_once=self.batch)


def total_iterations(levels: tuple[RegistrationLevel, ...]) -> int:
    """Most iterations of one hypothesis over all levels and looks."""
    return sum(level.rounds * level.iterations for level in levels)


def with_iterations(levels: tuple[RegistrationLevel, ...], most: int) -> tuple[RegistrationLevel, ...]:
    """The levels with their iterations scaled so that there are at most so many in all, and hardly fewer.

    Raises ValueError for fewer than one per look.
    """
    looks, whole = sum(level.rounds for level in levels), total_iterations(levels)
    if most < looks:
        raise ValueError(f"iterations: expected {looks} or more, one for each look of the levels, got {most}")
    scaled = [replace(level, iterations=max(1, level.iterations * most // whole)) for level in levels]
    for i in sorted(range(len(levels)), key=lambda i: -(levels[i].iterations * most % whole)):
        left = most - total_iterations(tuple(scaled))
        if left >= scaled[i].rounds:
            scaled[i] = replace(scaled[i], iterations=scaled[i].iterations + 1)
    while total_iterations(tuple(scaled)) > most:  # where the one iteration that every look needs was too many
        i = max(range(len(scaled)), key=lambda i: scaled[i].iterations)
        scaled[i] = replace(scaled[i], iterations=scaled[i].iterations - 1)
    return tuple(scaled)
