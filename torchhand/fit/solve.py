"""The one outer loop of all estimation: associate, minimise, associate anew, from coarse to fine, for many hypotheses.

Data are associated with the posed hands, an optimiser lowers the cost of that association within the joint limits, and
so on with finer and finer tolerance. Every association of the last stage is an honest evaluation of the hands that it
began with; the cheapest of them is the result, so that the best iterate survives.
"""

from dataclasses import dataclass, fields, replace
from enum import IntEnum

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import at_once_on, is_host
from torchhand.fit.observation import Explained
from torchhand.fit.problem import Linearization, Problem
from torchhand.fit.schedule import Schedule, Stage
from torchhand.hand import HandPose
from torchhand.numerics.least_squares import (
    DescentSettings,
    LeastSquares,
    LevenbergMarquardtSettings,
    NormalEquations,
    Status,
    after_box_step,
    damped_box_step,
    gradient_descent,
    levenberg_marquardt,
)
from torchhand.precision import require_exact, without_autocast

_COST_TOLERANCE = 1e-3  # share of the cost below which a step is not worth taking
_STEP_TOLERANCE = 1e-5
_DAMPING = 1e-2
_DESCENT = 10  # iterations of gradient descent for one of Levenberg-Marquardt
_ARRIVED = 0.04  # share of the cost that a step promises, below which it is the last of a fit without line search


_OF_HYPOTHESES = ("cost", "misfit", "status", "covariance")


class SolveStatus(IntEnum):
    """How a hypothesis ended."""

    CONVERGED = Status.CONVERGED.value
    """No step promises a noticeable decrease of the cost."""
    STALLED = Status.STALLED.value
    """Out of iterations: the best pose found."""
    FAILED = Status.FAILED.value
    """Nothing of the hand was ever in sight, or the start was not finite: the start."""
    NO_DATA = 3
    """No observation has data to compare a hand with: the start."""


@dataclass(frozen=True, kw_only=True)
class Solutions:
    """Estimated hands, one per hypothesis, in the world."""

    pose: HandPose
    """Poses (*hypotheses), with zero rotation vectors, within the limits."""
    cost: Float[Tensor, "*hypotheses"]
    """Nats, associated at the pose itself with the tolerance of the last stage: comparable between hypotheses; infinite
    if failed."""
    misfit: Float[Tensor, "*hypotheses"]
    """Nats of the observations alone, without the priors: what hypotheses with priors of their own, such as about their
    starts, have in common. Infinite if failed."""
    status: Int[Tensor, "*hypotheses"]
    """Numbers of `SolveStatus`."""
    iterations: Int[Tensor, "*hypotheses"]
    """Evaluations over all associations."""
    covariance: Float[Tensor, "*hypotheses free free"]
    """Covariance of the free parameters, the rotation as a left perturbation of the reference; NaN if failed."""
    explained: tuple[Explained, ...]
    """How well every observation is explained, view by view; a row per flattened hypothesis."""

    @property
    def best(self) -> int:
        """Place of the lowest cost among the flattened hypotheses."""
        return int(self.cost.reshape(-1).argmin())

    @property
    def is_sound(self) -> Bool[Tensor, "*hypotheses"]:
        """Hypotheses that have a finite cost."""
        return self.cost.isfinite()

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "Solutions":
        """Some of the flattened hypotheses, in the order given."""
        free = self.covariance.shape[-1]
        return Solutions(
            pose=self.pose.reshape(-1)[rows],
            cost=self.cost.reshape(-1)[rows],
            misfit=self.misfit.reshape(-1)[rows],
            status=self.status.reshape(-1)[rows],
            iterations=self.iterations.reshape(-1)[rows],
            covariance=self.covariance.reshape(-1, free, free)[rows],
            explained=tuple(one.rows(rows) for one in self.explained),
        )

    def reshape(self, batch: torch.Size) -> "Solutions":
        """The flattened hypotheses in another batch shape."""
        names = [f.name for f in fields(Solutions) if f.name not in ("pose", "explained")]
        shaped = {name: getattr(self, name).reshape((*batch, *getattr(self, name).shape[1:])) for name in names}
        return replace(self, pose=self.pose.reshape(*batch), **shaped)

    def or_cheaper(self, rows: Int[Tensor, "n"], others: "Solutions") -> "Solutions":
        """The flattened hypotheses, with other solutions of some of them in place of those that cost more; their
        iterations stay."""
        better = others.cost < self.cost[rows]

        def chosen(one: Tensor, other: Tensor) -> Tensor:
            is_other = better.reshape(-1, *(1,) * (one.ndim - 1))
            return one.index_copy(0, rows, torch.where(is_other, other, one[rows]))

        def explained(one: Explained, other: Explained) -> Explained:
            names = [name for name in ("fraction", "distance", "inside") if getattr(one, name) is not None]
            return replace(one, **{name: chosen(getattr(one, name), getattr(other, name)) for name in names})

        return replace(
            self,
            pose=HandPose(
                dofs=chosen(self.pose.dofs, others.pose.dofs),
                reference=chosen(self.pose.reference, others.pose.reference),
            ),
            explained=tuple(explained(*pair) for pair in zip(self.explained, others.explained, strict=True)),
            **{name: chosen(getattr(self, name), getattr(others, name)) for name in _OF_HYPOTHESES},
        )

    def select(self, index: int) -> "Solutions":
        """One of the flattened hypotheses, without batch dimensions (but for `explained`, which keeps one row)."""
        one = self.rows(torch.tensor([index], device=self.cost.device))
        return replace(
            one,
            pose=one.pose[0],
            cost=one.cost[0],
            misfit=one.misfit[0],
            status=one.status[0],
            iterations=one.iterations[0],
            covariance=one.covariance[0],
        )

    def explained_by(self, name: str) -> Explained:
        """What is told of an observation by its name; that of the first view where there are several.

        Raises ValueError for a name that no observation has.
        """
        for one in self.explained:
            if one.name == name:
                return one
        raise ValueError(f"explained: expected one of {', '.join({one.name for one in self.explained})}, got {name!r}")


@without_autocast
def solve(problem: Problem, starts: HandPose, schedule: Schedule, *, at_once: int = 128) -> Solutions:
    """Estimate poses from many starts, each by itself, the shape held.

    starts: any batch shape; they are put into the pose space and the joint limits. at_once: hypotheses that a processor
    works on together, which bounds the memory; an accelerator takes `devices.MORE` times as many.

    Computes in the dtype of the problem's pose space, float32 or float64; ValueError for half precision. Never raises
    for what else data or a start may be: see `SolveStatus`. One hypothesis never touches another.
    """
    if not schedule:
        raise ValueError("schedule: expected at least one stage, got none")
    for name, values in (("problem.space", problem.space.basis), ("starts", starts.dofs)):
        require_exact(name, values.dtype)
    batch = starts.batch_shape
    flat = starts.to(problem.space.basis).reshape(-1)
    parts = []
    at_once = at_once_on(flat.dofs.device, at_once)
    for first in range(0, max(1, len(flat)), at_once):
        part = slice(first, first + at_once)
        with torch.inference_mode():  # a sixth faster than without gradients alone
            parts.append(_solved(problem.rows(part), flat[part].normalized(), schedule))
    return _joined(parts, batch)


def _solved(problem: Problem, start: HandPose, schedule: Schedule) -> Solutions:
    if problem.is_empty or not len(start):
        return _unmoved(problem, start, SolveStatus.NO_DATA)
    values, reference = problem.values_of(start), start.reference
    iterations = torch.zeros(len(start), dtype=torch.long, device=values.device)
    status = torch.zeros_like(iterations)
    kept: _Evaluated | None = None
    is_evaluated = False  # where the hands are now
    for stage in schedule:
        has_arrived = torch.zeros_like(status, dtype=torch.bool)
        for _ in range(stage.rounds):
            here = problem.associated(values, reference, stage)
            first = here.here()
            if stage is schedule[-1]:
                own = _Evaluated.of(here, first)
                kept = own if kept is None else kept.or_better(own)
            found = _minimised(here, first, stage)
            if stage.until_arrived and stage.method == "gauss_newton":
                found, has_arrived = _unless_arrived(found, here, has_arrived)
            status, iterations = found.status, iterations + found.iterations
            is_evaluated = stage is schedule[-1] and is_host(values.device) and bool(has_arrived.all())
            if is_evaluated:
                assert kept is not None
                kept = kept.after(found, here, first)
                break
            values, reference = problem.rebased(found.values, reference)
    assert kept is not None
    if not is_evaluated:
        last = problem.associated(values, reference, schedule[-1])
        kept = kept.or_better(_Evaluated.of(last, last.here()))
    failed = ~kept.cost.isfinite()
    pose = problem.pose_of(kept.values, kept.reference).normalized()
    return Solutions(
        pose=HandPose(
            dofs=torch.where(failed[:, None], start.dofs, pose.dofs),
            reference=torch.where(failed[:, None, None], start.reference, pose.reference),
        ),
        cost=kept.cost,
        misfit=kept.misfit,
        status=torch.where(failed, SolveStatus.FAILED.value, status.clamp_max(Status.STALLED.value)),
        iterations=iterations,
        covariance=covariance_of(kept.matrix, ~failed),
        explained=kept.explained,
    )


def _minimised(here: Linearization, first: NormalEquations, stage: Stage) -> LeastSquares:
    """The optimiser between two associations."""
    lower, upper = here.problem.bounds
    if stage.method == "gauss_newton":
        return _one_step(here, first)
    if stage.method == "gradient_descent":
        descent = DescentSettings(iterations=_DESCENT * stage.iterations, cost_tolerance=0.1 * _COST_TOLERANCE)
        return gradient_descent(
            here.equations, here.values, lower=lower, upper=upper, settings=descent, takes_rows=True
        )
    newton = LevenbergMarquardtSettings(
        iterations=stage.iterations, damping=_DAMPING, cost_tolerance=_COST_TOLERANCE, step_tolerance=_STEP_TOLERANCE
    )
    return levenberg_marquardt(
        here.equations, here.values, lower=lower, upper=upper, settings=newton, takes_rows=True, first=first
    )


def _one_step(here: Linearization, first: NormalEquations) -> LeastSquares:
    """One damped Gauss-Newton step within the bounds, whatever it does to the cost."""
    (lower, upper), values = here.problem.bounds, here.values
    damping = torch.full_like(first.cost, _DAMPING)
    step, is_solved = damped_box_step(first.matrix, first.gradient, damping, lower - values, upper - values)
    is_sound = is_solved & first.cost.isfinite() & step.isfinite().all(-1)
    is_there = -0.5 * (first.gradient * step).sum(-1) <= _ARRIVED * first.cost
    status = torch.where(is_there, Status.CONVERGED.value, Status.STALLED.value)
    return LeastSquares(
        values=torch.where(is_sound[:, None], after_box_step(values, step, lower, upper), values),
        cost=first.cost,
        status=torch.where(is_sound, status, Status.FAILED.value),
        iterations=torch.ones(len(values), dtype=torch.long, device=values.device),
        matrix=first.matrix,
        gradient=first.gradient,
        on_bound=(values <= lower) | (values >= upper),
    )


def _unless_arrived(
    found: LeastSquares, here: Linearization, has_arrived: Bool[Tensor, "k"]
) -> tuple[LeastSquares, Bool[Tensor, "k"]]:
    """A further step of the hypotheses that had not arrived before it, and which have arrived with it: where it
    promises no noticeable decrease, or cannot be taken, it is the last."""
    stays = replace(
        found,
        values=torch.where(has_arrived[:, None], here.values, found.values),
        iterations=torch.where(has_arrived, 0, found.iterations),
        status=torch.where(has_arrived & (found.status == Status.STALLED.value), Status.CONVERGED.value, found.status),
    )
    return stays, has_arrived | (found.status != Status.STALLED.value)


@dataclass(frozen=True, kw_only=True)
class _Evaluated:
    """Hands that data were associated with, and what they cost; a row per hypothesis."""

    values: Float[Tensor, "k free"]
    reference: Float[Tensor, "k 3 3"]
    cost: Float[Tensor, "k"]
    misfit: Float[Tensor, "k"]
    matrix: Float[Tensor, "k free free"]
    explained: tuple[Explained, ...]

    @classmethod
    def of(cls, here: Linearization, found: NormalEquations) -> "_Evaluated":
        """Hands of which no observation sees anything, or whose cost is no finite number, cost infinitely much."""
        explained = here.explained()
        is_sound = found.cost.isfinite() & found.gradient.isfinite().all(-1)
        if explained:
            is_sound &= torch.stack([one.distance.isfinite() for one in explained]).any(0)
        return cls(
            values=here.values,
            reference=here.hands.pose.reference,
            cost=torch.where(is_sound, found.cost, torch.inf),
            misfit=torch.where(is_sound, here.misfit(found.cost), torch.inf),
            matrix=found.matrix,
            explained=explained,
        )

    def after(self, found: LeastSquares, here: Linearization, first: NormalEquations) -> "_Evaluated":
        """The hands after a last step from where they are the best, its promise believed; what they explain is what
        they explained before it."""
        is_taken = (self.cost == first.cost) & self.cost.isfinite()
        step = torch.where(is_taken[:, None], found.values - here.values, 0.0)
        promised = torch.where(is_taken, -0.5 * (first.gradient * step).sum(-1), 0.0)
        values = torch.where(is_taken[:, None], found.values, self.values)
        return replace(self, values=values, cost=self.cost - promised, misfit=self.misfit - promised)

    def or_better(self, other: "_Evaluated") -> "_Evaluated":
        """The cheaper of the two, hypothesis by hypothesis."""
        better = other.cost <= self.cost

        def chosen(one: Tensor, two: Tensor) -> Tensor:
            return torch.where(better.reshape(-1, *(1,) * (one.ndim - 1)), two, one)

        def better_of(one: Explained, two: Explained) -> Explained:
            inside = chosen(one.inside, two.inside) if one.inside is not None and two.inside is not None else None
            fraction, distance = chosen(one.fraction, two.fraction), chosen(one.distance, two.distance)
            return replace(one, fraction=fraction, distance=distance, inside=inside)

        return _Evaluated(
            values=chosen(self.values, other.values),
            reference=chosen(self.reference, other.reference),
            cost=chosen(self.cost, other.cost),
            misfit=chosen(self.misfit, other.misfit),
            matrix=chosen(self.matrix, other.matrix),
            explained=tuple(better_of(*pair) for pair in zip(self.explained, other.explained, strict=True)),
        )


def covariance_of(
    matrix: Float[Tensor, "hypotheses free free"], is_good: Bool[Tensor, "hypotheses"]
) -> Float[Tensor, "hypotheses free free"]:
    """Inverses of the matrices of the normal equations; NaN where they are not positive definite or not good."""
    identity = torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
    factor, info = torch.linalg.cholesky_ex(torch.where(is_good[:, None, None], matrix, identity))
    is_known = ((info == 0) & is_good)[:, None, None]
    return torch.where(is_known, torch.cholesky_inverse(torch.where(is_known, factor, identity)), torch.nan)


def _unmoved(problem: Problem, start: HandPose, status: SolveStatus) -> Solutions:
    size, count, like = problem.space.size, len(start), problem.space.basis
    zeros = torch.zeros(count, dtype=torch.long, device=like.device)
    nothing = like.new_full((count,), torch.inf)
    return Solutions(
        pose=start,
        cost=nothing,
        misfit=nothing,
        status=zeros + status.value,
        iterations=zeros,
        covariance=like.new_full((count, size, size), torch.nan),
        explained=(),
    )


def _joined(parts: list[Solutions], batch: torch.Size) -> Solutions:
    """The hypotheses of all parts, in the shape of the starts."""
    explained = Explained.joined([part.explained for part in parts], [len(part.pose) for part in parts])
    names = [f.name for f in fields(Solutions) if f.name not in ("pose", "explained")]
    tensors = {name: torch.cat([getattr(part, name) for part in parts]) for name in names}
    return Solutions(pose=HandPose.cat([part.pose for part in parts]), explained=explained, **tensors).reshape(batch)
