"""Poses of many frames and what they share, estimated as one problem by variable projection.

The shared unknowns are few and the frames may be thousands, so the cost is minimised over the shared unknowns, that of
each trial being the cost of the poses that are best for it (Golub and Pereyra 1973). At the best poses its derivative
is the partial one, and the Schur complement of the joint normal equations is its second derivative as far as
Gauss-Newton knows it. Every pose keeps its own damping, so that a frame whose posture is badly determined slows down
none of the others, as it would in joint steps with one damping for all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import read_back, sent_to
from torchhand.fit.observation import Explained, Factor, PosedHands
from torchhand.fit.problem import Linearization, Problem
from torchhand.fit.schedule import Schedule, Stage
from torchhand.fit.solve import SolveStatus, covariance_of
from torchhand.hand import HandPose
from torchhand.numerics.least_squares import (
    ArrowEquations,
    LeastSquares,
    LevenbergMarquardtSettings,
    NormalEquations,
    Status,
    damped_box_step,
    levenberg_marquardt,
)
from torchhand.precision import without_autocast

_DAMPING = 1e-3  # of the shared unknowns, at the first step
_POSE_DAMPING = 1e-4
_FOLLOWING = 6  # iterations of the poses for each trial of the shared unknowns; the next trial goes on from there
_COST_FLOOR = 1e-11  # nats: less than this is nothing
_DERIVATIVES = 256  # frames whose derivatives are held at a time


@dataclass(frozen=True, kw_only=True)
class SharedSolution:
    """Where a problem of many frames ended."""

    pose: HandPose
    """Poses (frames), with zero rotation vectors, within the limits; those of the start where a frame failed."""
    shape: Float[Tensor, "shape"]
    extra: Float[Tensor, "extra"]
    """The shared numbers after the shape."""
    shape_std: Float[Tensor, "shape"]
    """Standard deviations by the curvature of the cost, of the poses' uncertainty too; 0 for parameters that were
    frozen."""
    shared_covariance: Float[Tensor, "c c"]
    """Covariance of the shared unknowns."""
    follow: Float[Tensor, "frames free c"]
    """Derivative of the free parameters of the best poses in the shared unknowns."""
    covariance: Float[Tensor, "frames free free"]
    """Covariance of the free parameters of every pose, what is shared being uncertain too; NaN where a frame failed."""
    cost: float
    """Nats, of all frames that did not fail together, with what is believed of the shared unknowns."""
    status: Status
    """Status of the shared unknowns; that of the worst frame where there are none."""
    iterations: int
    """Trials of the shared unknowns."""
    frame_status: Int[Tensor, "frames"]
    """Numbers of `SolveStatus`. A frame fails whose cost is not finite at its start; it tells nothing."""
    frame_iterations: Int[Tensor, "frames"]
    """Evaluations of every frame's last solution."""
    explained: tuple[Explained, ...]
    """A row for each frame."""


@without_autocast
def solve_shared(
    problem: Problem,
    starts: HandPose,
    schedule: Schedule,
    *,
    cost_tolerance: float = 1e-4,
    pose_tolerance: float = 1e-3,
    information: Float[Tensor, "36"] | None = None,
    at_once: int = 2048,
) -> SharedSolution:
    """Estimate the poses of all frames and the problem's shared unknowns, from one start.

    starts: (frames); the problem's shape is its own start. Without shared unknowns every frame is estimated by itself.
    cost_tolerance: share of the whole cost below which a step of the shared unknowns is not worth taking;
    pose_tolerance: the same of a frame's own cost and its pose. information: what is known of each DOF besides, such as
    that it lies between its limits; it counts in the covariances alone. at_once: frames that are worked on together,
    which bounds the memory.

    Stages by "gauss_newton" take one step of poses and shared unknowns together after each association, whatever it
    does to the cost: where data are associated anew after every step, that is all that an association is good for.

    Raises ValueError for a problem without frames or without data.
    """
    if not schedule:
        raise ValueError("schedule: expected at least one stage, got none")
    if problem.is_empty or not len(starts):
        raise ValueError("problem: expected data and at least one frame")
    with torch.inference_mode():
        work = _Work.begin(problem, starts.to(problem.space.basis).normalized(), pose_tolerance, at_once)
        for stage in schedule:
            for _ in range(stage.rounds):
                work.associate(stage)
                if stage.method == "gauss_newton":
                    work.step(cost_tolerance)
                else:
                    work.solve_poses(stage.iterations)
                    work.descend(stage.iterations, cost_tolerance)
        return work.solution(schedule[-1], information)


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Some of the frames, with the factors of their association."""

    rows: slice
    here: Linearization

    def solved(
        self, values: Float[Tensor, "k free"], vector: Float[Tensor, "c"], settings: LevenbergMarquardtSettings
    ) -> LeastSquares:
        """The poses of lowest cost for given shared unknowns, every frame by itself."""
        hands, (lower, upper) = self.here.problem.hands(self.here.hands.pose, vector), self.here.problem.bounds
        given = replace(self.here, hands=replace(hands, unknowns=None))

        def equations(values: Tensor, rows: Tensor) -> NormalEquations:
            found = [
                given.equations(*some) for some in zip(*(x.split(_DERIVATIVES) for x in (values, rows)), strict=True)
            ]
            matrix, gradient, cost = (
                torch.cat([getattr(own, name) for own in found]) for name in ("matrix", "gradient", "cost")
            )
            return NormalEquations(matrix=matrix, gradient=gradient, cost=cost)

        return levenberg_marquardt(equations, values, lower=lower, upper=upper, settings=settings, takes_rows=True)

    def arrow(
        self, values: Float[Tensor, "k free"], vector: Float[Tensor, "c"], is_sound: Bool[Tensor, "k"]
    ) -> ArrowEquations:
        """Normal equations of these poses and the shared unknowns; frames that are not sound tell nothing."""
        each = torch.arange(len(values), device=values.device).split(_DERIVATIVES)
        found = [self._arrow(rows, values[rows], vector, is_sound[rows]) for rows in each]
        return ArrowEquations.cat(found)

    def arrow_here(self, vector: Float[Tensor, "c"], is_sound: Bool[Tensor, "k"]) -> ArrowEquations:
        """The same at the hands of the association, of which most is known."""
        if len(self.here.hands) > _DERIVATIVES:
            return self.arrow(self.here.values, vector, is_sound)
        _, moving = self.here.problem.dofs_of(self.here.values)
        return self._arrow_of(self.here.hands, self.here.factors, moving, is_sound)

    def _arrow(
        self, rows: Int[Tensor, "n"], values: Float[Tensor, "n free"], vector: Tensor, is_sound: Bool[Tensor, "n"]
    ) -> ArrowEquations:
        problem, reference = self.here.problem, self.here.hands.pose.reference
        is_all = len(rows) == len(reference)
        factors = self.here.factors if is_all else tuple(factor.rows(rows) for factor in self.here.factors)
        dofs, moving = problem.dofs_of(values)
        hands = problem.hands(HandPose(dofs=dofs, reference=reference[rows]), vector)
        return self._arrow_of(hands, factors, moving, is_sound)

    def _arrow_of(
        self,
        hands: PosedHands,
        factors: tuple[Factor, ...],
        moving: Bool[Tensor, "n 36"],
        is_sound: Bool[Tensor, "n"],
    ) -> ArrowEquations:
        found, basis = self.here.sum(factors, hands), self.here.basis(moving)
        mixed, gradient, matrix = (  # None where nothing is shared
            basis.new_zeros(len(hands), *sizes) if part is None else part
            for part, sizes in (
                (found.mixed, (basis.shape[-2], 0)),
                (found.shared_gradient, (0,)),
                (found.shared_matrix, (0, 0)),
            )
        )
        is_sound = is_sound & found.cost.isfinite() & found.gradient.isfinite().all(-1)

        def sound(part: Tensor) -> Tensor:
            return torch.where(is_sound.reshape(-1, *(1,) * (part.ndim - 1)), part, 0.0)

        return ArrowEquations(
            blocks=sound(basis.mT @ (found.matrix @ basis)),
            mixed=sound(basis.mT @ mixed),
            shared=sound(matrix).sum(0),
            block_gradient=sound((found.gradient[:, None] @ basis).squeeze(1)),
            shared_gradient=sound(gradient).sum(0),
            cost=sound(found.cost).sum(),
        )


@dataclass(kw_only=True)
class _Work:
    """Where the estimate of all frames stands."""

    problem: Problem
    values: Float[Tensor, "frames free"]
    reference: Float[Tensor, "frames 3 3"]
    vector: Float[Tensor, "c"]
    """Shared unknowns that the poses go with."""
    is_sound: Bool[Tensor, "frames"]
    frame_status: Int[Tensor, "frames"]
    frame_iterations: Int[Tensor, "frames"]
    pose_tolerance: float
    at_once: int
    status: Status = Status.CONVERGED
    iterations: int = 0
    parts: tuple[_Part, ...] = ()
    cost: Float[Tensor, ""]
    """Lowest that a trial of the shared unknowns had since the association."""
    follow: tuple[Float[Tensor, "k free c"], ...] = ()
    """How the poses of every part change with the shared unknowns."""

    @classmethod
    def begin(cls, problem: Problem, start: HandPose, pose_tolerance: float, at_once: int) -> "_Work":
        values = problem.values_of(start)
        shared = None if problem.shared is None else sent_to(problem.shared, values.device)
        problem = replace(problem, shared=shared)
        nothing = torch.zeros(len(start), dtype=torch.long, device=values.device)
        return cls(
            problem=problem,
            values=values,
            reference=start.reference,
            vector=values.new_zeros(0) if shared is None else shared.vector(problem.shape.to(values)),
            is_sound=nothing == 0,
            frame_status=nothing,
            frame_iterations=nothing,
            pose_tolerance=pose_tolerance,
            at_once=at_once,
            cost=values.new_full((), torch.inf),
        )

    def associate(self, stage: Stage) -> None:
        """Data with the hands as they are."""
        self.values, self.reference = self.problem.rebased(self.values, self.reference)
        self.parts = tuple(
            _Part(
                rows=rows,
                here=self.problem.rows(rows).associated(self.values[rows], self.reference[rows], stage, self.vector),
            )
            for rows in (slice(first, first + self.at_once) for first in range(0, len(self.values), self.at_once))
        )
        self.cost = self.vector.new_full((), torch.inf)
        self.follow = tuple(
            own.new_zeros(*own.shape, len(self.vector)) for own in (self.values[part.rows] for part in self.parts)
        )

    def solve_poses(self, iterations: int) -> None:
        """Finds the best poses for the shared unknowns as they are."""
        settings = self._pose_settings(iterations)
        found = [part.solved(self.values[part.rows], self.vector, settings) for part in self.parts]
        self.values = torch.cat([own.values for own in found])
        self.frame_status = torch.cat([own.status for own in found])
        self.frame_iterations = torch.cat([own.iterations for own in found])
        self.is_sound = self.frame_status != Status.FAILED.value

    def descend(self, iterations: int, cost_tolerance: float) -> None:
        """Levenberg-Marquardt over the shared unknowns; the poses go along."""
        shared = self.problem.shared
        if shared is None or not shared.size or not read_back(self.is_sound).any():
            return
        lower, upper = shared.bounds(self.vector)
        settings = LevenbergMarquardtSettings(iterations=iterations, damping=_DAMPING, cost_tolerance=cost_tolerance)
        found = levenberg_marquardt(self._trial, self.vector, lower=lower, upper=upper, settings=settings)
        ended, tried = read_back(torch.stack((found.status, found.iterations))).tolist()
        self.status, self.iterations = Status(ended), self.iterations + tried

    def step(self, cost_tolerance: float) -> None:
        """One step of Gauss and Newton for poses and shared unknowns together; what leaves its bounds is put onto
        them."""
        lower, upper = self.problem.bounds
        left = [part.arrow_here(self.vector, self.is_sound[part.rows]).eliminated() for part in self.parts]
        moved = self._shared_step([one.equations for one in left], cost_tolerance)
        steps = torch.cat([one.step + one.follow @ moved for one in left])
        self.values, self.vector = (self.values + steps).clamp(lower, upper), self.vector + moved

    def _shared_step(self, left: Sequence[NormalEquations], cost_tolerance: float) -> Float[Tensor, "c"]:
        """The step of the shared unknowns, given what is left of the equations of all parts."""
        shared = self.problem.shared
        if shared is None or not shared.size:
            return torch.zeros_like(self.vector)
        prior = shared.prior_equations(self.vector, self.problem.shape.to(self.vector))
        matrix, gradient, cost = (
            torch.stack([getattr(one, name) for one in (prior, *left)]).sum(0)
            for name in ("matrix", "gradient", "cost")
        )
        lower, upper = shared.bounds(self.vector)
        rooms = ((lower - self.vector)[None], (upper - self.vector)[None])
        step = damped_box_step(matrix[None], gradient[None], matrix.new_zeros(1), *rooms)[0][0]
        is_there = bool(read_back(-0.5 * (gradient @ step) <= cost_tolerance * cost))
        self.status, self.iterations = Status.CONVERGED if is_there else Status.STALLED, self.iterations + 1
        return step

    def _trial(self, vector: Float[Tensor, "c"]) -> NormalEquations:
        """Normal equations of the shared unknowns, every pose the best for them; the best trial is kept."""
        shared = self.problem.shared
        assert shared is not None
        prior = shared.prior_equations(vector, self.problem.shape.to(vector))
        (lower, upper), settings = self.problem.bounds, self._pose_settings(_FOLLOWING)
        matrix, gradient, cost = prior.matrix.clone(), prior.gradient.clone(), prior.cost.clone()
        values, follow = [], []
        for number, part in enumerate(self.parts):
            start = self.values[part.rows]
            start = (start + self.follow[number] @ (vector - self.vector)).clamp(lower, upper)
            found = part.solved(start, vector, settings).values
            arrow = part.arrow(found, vector, self.is_sound[part.rows])
            fixed = (found <= lower) & (arrow.block_gradient > 0) | (found >= upper) & (arrow.block_gradient < 0)
            left = arrow.eliminated(fixed)
            own = left.equations
            matrix, gradient, cost = matrix + own.matrix, gradient + own.gradient, cost + own.cost
            values.append(found)
            follow.append(left.follow)
        is_better = cost < self.cost  # chosen without a number being read: the device need not be waited for
        self.cost, self.vector = torch.where(is_better, cost, self.cost), torch.where(is_better, vector, self.vector)
        self.values = torch.where(is_better, torch.cat(values), self.values)
        self.follow = tuple(torch.where(is_better, *own) for own in zip(follow, self.follow, strict=True))
        return NormalEquations(matrix=matrix, gradient=gradient, cost=cost)

    def solution(self, stage: Stage, information: Float[Tensor, "36"] | None) -> SharedSolution:
        """The solution of data associated once more; constraints on what is shared are kept from here on."""
        shared, shape = self.problem.shared, self.problem.shape.to(self.values)
        if shared is not None and shared.size:
            shape = shared.feasible(self.vector, shape)
            self.problem, count = replace(self.problem, shape=shape), len(shared.columns)
            self.vector = torch.cat((shared.vector(shape)[:count], self.vector[count:]))
        if len(self.vector) or stage.method == "gauss_newton":
            self.associate(stage)
            self.solve_poses(stage.iterations)
        self.associate(stage)
        cost, covariance, shared_covariance, follow = self._covariances(information)
        std = torch.zeros_like(shape)
        if shared is not None:
            columns = shared.places(std.device)
            std[columns] = shared_covariance.diagonal()[: len(columns)].clamp_min(0).sqrt()
        else:
            statuses = read_back(self.frame_status)
            if (statuses != Status.CONVERGED.value).any():
                self.status = Status(int(statuses.max()))
        counts = [len(part.here.hands) for part in self.parts]
        return SharedSolution(
            pose=self.problem.pose_of(self.values, self.reference),
            shape=shape,
            extra=self.vector[:0] if shared is None else shared.extras(self.vector),
            shape_std=std,
            shared_covariance=shared_covariance,
            follow=follow,
            covariance=covariance,
            cost=cost,
            status=self.status,
            iterations=self.iterations,
            frame_status=torch.where(self.is_sound, self.frame_status, SolveStatus.FAILED.value),
            frame_iterations=self.frame_iterations,
            explained=Explained.joined([part.here.explained() for part in self.parts], counts),
        )

    def _covariances(
        self, information: Float[Tensor, "36"] | None
    ) -> tuple[float, Float[Tensor, "frames free free"], Float[Tensor, "c c"], Float[Tensor, "frames free c"]]:
        """The whole cost, the covariances of poses and shared unknowns, and how the former follow the latter."""
        shared, basis = self.problem.shared, self.problem.space.basis
        known = basis.new_zeros(len(basis)) if information is None else information.to(basis)
        prior_information = torch.diag((basis.square() * known[:, None]).sum(0))
        matrix, cost = self.vector.new_zeros(len(self.vector), len(self.vector)), self.vector.new_zeros(())
        if shared is not None:
            prior = shared.prior_equations(self.vector, self.problem.shape)
            matrix, cost = prior.matrix.clone(), prior.cost
        own, follow = [], []
        for part in self.parts:
            arrow = part.arrow(self.values[part.rows], self.vector, self.is_sound[part.rows])
            arrow = replace(arrow, blocks=arrow.blocks + prior_information)
            own.append(covariance_of(arrow.blocks, self.is_sound[part.rows]))
            cost = cost + arrow.cost
            if len(self.vector):
                left = arrow.eliminated()
                matrix = matrix + left.equations.matrix
                follow.append(left.follow)
        covariance = torch.cat(own)
        total = float(read_back(cost))
        if not len(self.vector):
            return total, covariance, matrix, covariance[..., :0]
        of_shared = covariance_of(matrix[None], torch.ones_like(self.is_sound[:1]))[0]
        for part, following in zip(self.parts, follow, strict=True):
            covariance[part.rows] += following @ of_shared @ following.mT
        return total, covariance, of_shared, torch.cat(follow)

    def _pose_settings(self, iterations: int) -> LevenbergMarquardtSettings:
        return LevenbergMarquardtSettings(
            iterations=iterations,
            damping=_POSE_DAMPING,
            cost_tolerance=self.pose_tolerance,
            step_tolerance=0.01 * self.pose_tolerance,
            cost_floor=_COST_FLOOR,
        )
