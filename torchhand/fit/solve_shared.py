"""Poses of several frames and what they share, estimated as one problem: the same loop as `solve`, joint steps."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.observation import Explained
from torchhand.fit.problem import Linearization, Problem
from torchhand.fit.schedule import Schedule
from torchhand.hand import HandPose
from torchhand.numerics.least_squares import (
    ArrowEquations,
    ArrowSolution,
    ArrowValues,
    LevenbergMarquardtSettings,
    Status,
    arrow_levenberg_marquardt,
)

_DAMPING = 1e-2


@dataclass(frozen=True, kw_only=True)
class SharedSolution:
    """Where a problem with shared unknowns ended."""

    pose: HandPose
    """(frames), with zero rotation vectors, within the limits."""
    shape: Float[Tensor, "shape"]
    extra: Float[Tensor, "extra"]
    """The shared numbers after the shape."""
    shape_std: Float[Tensor, "shape"]
    """Standard deviations by the curvature of the cost, of the poses' uncertainty too; 0 for parameters that were
    held."""
    shared_covariance: Float[Tensor, "c c"]
    """Of the shared unknowns."""
    covariance: Float[Tensor, "frames free free"]
    """Of the free parameters of every pose, what is shared being uncertain too."""
    cost: float
    """Nats, of all frames together."""
    status: Status
    iterations: int
    explained: tuple[Explained, ...]
    """A row for each frame."""


def solve_shared(
    problem: Problem,
    starts: HandPose,
    schedule: Schedule,
    *,
    cost_tolerance: float = 1e-4,
) -> SharedSolution:
    """Estimate the poses of all frames and the problem's shared unknowns, from one start.

    starts: (frames); the problem's shape is its own start. cost_tolerance: share of the cost below which a step is not
    worth taking.

    Raises ValueError for a problem without shared unknowns, without frames or without data.
    """
    if problem.shared is None:
        raise ValueError("problem: expected shared unknowns; without them every frame is a problem of `solve`")
    if problem.is_empty or not len(starts):
        raise ValueError("problem: expected data and at least one frame")
    with torch.inference_mode():
        return _solved(problem, starts.to(problem.space.basis).normalized(), schedule, cost_tolerance)


def _solved(problem: Problem, start: HandPose, schedule: Schedule, cost_tolerance: float) -> SharedSolution:
    shared = problem.shared
    assert shared is not None
    values, reference = problem.values_of(start), start.reference
    vector = shared.vector(problem.shape.to(values))
    iterations, status = 0, Status.STALLED
    for stage in schedule:
        settings = LevenbergMarquardtSettings(
            iterations=stage.iterations, damping=_DAMPING, cost_tolerance=cost_tolerance
        )
        for _ in range(stage.rounds):
            here = problem.associated(values, reference, stage, vector)
            found = _minimised(here, values, vector, settings)
            iterations, status = iterations + found.iterations, found.status
            values, reference = problem.rebased(found.values.blocks, reference)
            vector = found.values.shared
    last = problem.associated(values, reference, schedule[-1], vector)
    equations = last.arrow(values, vector)
    covariance, shared_covariance = covariances(equations)
    shape = shared.shape(vector, problem.shape.to(values))
    std = torch.zeros_like(shape)
    count = len(shared.columns)
    std[list(shared.columns)] = shared_covariance.diagonal()[:count].clamp_min(0).sqrt()
    return SharedSolution(
        pose=problem.pose_of(values, reference),
        shape=shape,
        extra=shared.extras(vector),
        shape_std=std,
        shared_covariance=shared_covariance,
        covariance=covariance,
        cost=float(equations.cost),
        status=status,
        iterations=iterations,
        explained=last.explained(),
    )


def _minimised(
    here: Linearization, values: Tensor, vector: Tensor, settings: LevenbergMarquardtSettings
) -> ArrowSolution:
    problem = here.problem
    assert problem.shared is not None
    ends = (
        ArrowValues(blocks=own.expand_as(values), shared=end)
        for own, end in zip(problem.bounds, problem.shared.bounds(vector), strict=True)
    )
    lower, upper = ends
    return arrow_levenberg_marquardt(
        lambda trial: here.arrow(trial.blocks, trial.shared),
        ArrowValues(blocks=values, shared=vector),
        lower,
        upper,
        settings,
    )


def covariances(equations: ArrowEquations) -> tuple[Float[Tensor, "frames free free"], Float[Tensor, "c c"]]:
    """Of every block with what is shared being uncertain too, and of what is shared; NaN where a matrix is singular."""
    matrix, _, solved = equations.eliminated()
    root, info = torch.linalg.cholesky_ex(matrix)
    shared = torch.cholesky_inverse(root) if int(info) == 0 else torch.full_like(matrix, torch.nan)
    factor, failed = torch.linalg.cholesky_ex(equations.blocks)
    own = torch.where((failed == 0)[:, None, None], torch.cholesky_inverse(factor), torch.nan)
    follow = solved[..., :-1]
    return own + follow @ shared @ follow.mT, shared
