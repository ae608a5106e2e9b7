"""The laws of the outer loop: hypotheses that do not touch, the best iterate, statuses, limits, pieces."""

import itertools
import math
from dataclasses import dataclass, field, replace

import pytest
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit.observation import Equations, Explained, Observation, PosedHands
from torchhand.fit.priors import ConstraintPrior, GaussianPrior
from torchhand.fit.problem import Problem
from torchhand.fit.schedule import Schedule, Stage
from torchhand.fit.solve import Solutions, SolveStatus, _minimised, covariance_of, solve
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandPose, PoseConstraints, PoseJacobian, named_pose_space
from torchhand.hand.limits import clamp_to_limits

MODEL = load_hand_model()
KINEMATICS = MODEL.kinematics(dtype=torch.float64)
SPACE = named_pose_space("dof26")
SCHEDULE = (Stage(gross_m=0.05, rounds=2, iterations=4), Stage(gross_m=0.004, rounds=2, iterations=4))
JACOBIAN = PoseJacobian(KINEMATICS)
INDEX = DOFS.index("index_pip_fe")


def normal(generator: torch.Generator, *size: int) -> Tensor:
    return torch.randn(*size, generator=generator, dtype=torch.float64)


def hands(generator: torch.Generator, *batch: int, spread: float = 0.2) -> HandPose:
    free = spread * normal(generator, *batch, SPACE.size)
    dofs = clamp_to_limits(SPACE.dof(free), MODEL.skeleton)
    dofs[..., 3:6] = 0.0
    return HandPose(dofs=dofs, reference=rotation_from_vector(normal(generator, *batch, 3)))


@dataclass(frozen=True, kw_only=True)
class Points:
    """Keypoints in the world, each drawn to its place beyond a distance less than within it: associated anew, another
    problem. Hands whose wrist is farther than a metre away see nothing of them."""

    points: Float[Tensor, "#rows 21 3"]
    is_empty: bool = False

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "Points":
        return self if len(self.points) == 1 else replace(self, points=self.points[rows])

    def associate(self, hands: PosedHands, stage: Stage) -> "PointsFactor":
        keypoints = _keypoints(hands.pose)
        distance = (keypoints - self.points).norm(dim=-1)
        std = 0.002 + 0.5 * stage.gross_m
        weight = std**-2 / (1 + (distance / (4 * stage.gross_m)).square()).square()
        is_seen = hands.pose.dofs[:, :3].norm(dim=-1) < 1.0
        return PointsFactor(
            points=self.points.expand(len(hands), -1, -1),
            weight=weight,
            distance=torch.where(is_seen, distance.mean(-1), torch.inf),
        )


@dataclass(frozen=True, kw_only=True)
class PointsFactor:
    points: Float[Tensor, "k 21 3"]
    weight: Float[Tensor, "k 21"]
    distance: Float[Tensor, "k"]

    def equations(self, hands: PosedHands) -> Equations:
        frames = KINEMATICS(hands.pose.dofs, root_reference=hands.pose.reference)
        weight = self.weight.repeat_interleave(3, 1)
        residual = (frames.keypoints - self.points).flatten(1)
        cost = 0.5 * (weight * residual.square()).sum(-1)
        return Equations.of_rows(residual, weight, JACOBIAN(hands.pose.dofs, frames).flatten(1, 2), cost)

    def rows(self, rows: Int[Tensor, "n"]) -> "PointsFactor":
        return PointsFactor(points=self.points[rows], weight=self.weight[rows], distance=self.distance[rows])

    def explained(self) -> tuple[Explained, ...]:
        return (Explained(name="points", view=None, fraction=(-self.distance).exp(), distance=self.distance),)


def _keypoints(pose: HandPose) -> Tensor:
    return KINEMATICS(pose.dofs, root_reference=pose.reference).keypoints


def problem(observation: Observation, starts: HandPose | None = None) -> Problem:
    """With constraints, and a start that is expected for each hypothesis where starts are given."""
    priors: tuple[Observation, ...] = (ConstraintPrior(constraints=PoseConstraints(MODEL.skeleton)),)
    if starts is not None:
        std = torch.full((SPACE.size,), 0.3, dtype=torch.float64)
        priors = (*priors, GaussianPrior.of_std(starts, std, SPACE))
    return Problem(
        space=SPACE,
        skeleton=MODEL.skeleton,
        shape=KINEMATICS.default_shape,
        observations=(observation,),
        priors=priors,
    )


def alike(one: Solutions, other: Solutions) -> None:
    torch.testing.assert_close(one.pose.dofs, other.pose.dofs, atol=1e-9, rtol=0, equal_nan=True)
    torch.testing.assert_close(one.pose.reference, other.pose.reference, atol=1e-9, rtol=0)
    torch.testing.assert_close(one.cost, other.cost, atol=0, rtol=1e-9)
    scale = float(one.covariance.nan_to_num().abs().max())
    torch.testing.assert_close(one.covariance, other.covariance, atol=1e-9 * scale, rtol=0, equal_nan=True)
    assert torch.equal(one.status, other.status)
    assert torch.equal(one.iterations, other.iterations)
    torch.testing.assert_close(one.explained[0].distance, other.explained[0].distance, atol=1e-9, rtol=0)


@pytest.fixture
def points(generator: torch.Generator) -> Points:
    return Points(points=_keypoints(hands(generator, 1)))


@pytest.mark.parametrize("method", ["levenberg_marquardt", "gauss_newton", "gradient_descent"])
def test_one_hypothesis_never_touches_another(method: str, points: Points, generator: torch.Generator) -> None:
    """A batch equals single calls, whatever stands beside: also hands that cannot be solved."""
    schedule: Schedule = tuple(replace(stage, method=method, iterations=2) for stage in SCHEDULE)
    starts = hands(generator, 6)
    starts.dofs[1, 7], starts.dofs[4, 0] = torch.nan, 50.0
    whole = solve(problem(points, starts), starts, schedule)
    for index in range(6):
        alike(whole.select(index), solve(problem(points, starts[index]), starts[index], schedule))


def test_angles_at_their_limits_stay_there_to_the_last_bit(points: Points, generator: torch.Generator) -> None:
    """An angle that a step leads to its limit has a derivative in the next one, and can leave it again."""
    starts = hands(generator, 40)
    within, (lower, upper) = problem(points, starts), problem(points).bounds
    stage = replace(SCHEDULE[0], method="gauss_newton")
    values, reference = within.values_of(starts), starts.reference
    count = 0
    for _ in range(4):
        here = within.associated(values, reference, stage)
        first = here.here()
        assert float(first.matrix.diagonal(dim1=-2, dim2=-1).min()) > 1e-3
        values = _minimised(here, first, stage).values
        is_near = ((values - lower).abs() < 1e-12) | ((values - upper).abs() < 1e-12)
        assert bool(((values == lower) | (values == upper))[is_near].all())
        count += int(is_near.sum())
        values, reference = within.rebased(values, reference)
    assert count > 100


@pytest.mark.parametrize("at_once", [1, 4, 100])
def test_the_number_at_once_changes_nothing(at_once: int, generator: torch.Generator) -> None:
    """Also where data and priors differ from hypothesis to hypothesis."""
    points, starts = Points(points=_keypoints(hands(generator, 6))), hands(generator, 6)
    alike(
        solve(problem(points, starts), starts, SCHEDULE, at_once=at_once),
        solve(problem(points, starts), starts, SCHEDULE, at_once=6),
    )


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_starts_of_any_shape(batch: tuple[int, ...], points: Points, generator: torch.Generator) -> None:
    starts = hands(generator, math.prod(batch))
    flat = solve(problem(points), starts, SCHEDULE)
    found = solve(problem(points), starts.reshape(*batch), SCHEDULE, at_once=4)
    assert found.pose.batch_shape == found.cost.shape == found.status.shape == torch.Size(batch)
    assert found.covariance.shape == (*batch, SPACE.size, SPACE.size)
    torch.testing.assert_close(found.pose.reshape(-1).dofs, flat.pose.dofs, atol=1e-9, rtol=0)
    assert found.best == flat.best
    rows = torch.arange(len(starts)).flip(0)
    assert torch.equal(found.rows(rows).cost, found.cost.reshape(-1).flip(0))
    assert torch.equal(found.rows(rows).explained[0].distance, found.explained[0].distance.flip(0))


def test_a_known_hand_is_found(points: Points, generator: torch.Generator) -> None:
    found = solve(problem(points), hands(generator, 8), SCHEDULE)
    missed = (_keypoints(found.pose) - points.points).norm(dim=-1).mean(-1)
    assert float(missed[found.best]) < 5e-4
    assert found.status[found.best] in (SolveStatus.CONVERGED, SolveStatus.STALLED)
    assert bool(found.is_sound.all())
    assert not bool(found.pose.dofs[:, 3:6].any())


def test_the_cost_is_that_of_the_result_itself(points: Points, generator: torch.Generator) -> None:
    """Associated anew at the result, as is what is explained; so hypotheses can be compared."""
    starts = hands(generator, 5)
    own = problem(points, starts)
    found = solve(own, starts, SCHEDULE)
    posed = own.hands(found.pose)
    factors = [one.associate(posed, SCHEDULE[-1]) for one in (*own.observations, *own.priors)]
    cost = torch.stack([factor.equations(posed).cost for factor in factors]).sum(0)
    torch.testing.assert_close(found.cost, cost, atol=0, rtol=1e-9)
    of_points = factors[0].equations(posed).cost
    torch.testing.assert_close(found.misfit, of_points, atol=1e-12 * float(cost.max()), rtol=1e-9)
    assert bool((found.misfit < found.cost).all())
    torch.testing.assert_close(found.explained_by("points").distance, factors[0].explained()[0].distance)
    matrices = torch.linalg.inv(found.covariance)
    assert float(torch.linalg.eigvalsh(matrices).min()) > 0
    with pytest.raises(ValueError, match="explained: expected one of points, got 'contour'"):
        found.explained_by("contour")


def test_more_rounds_never_make_it_worse(points: Points, generator: torch.Generator) -> None:
    """With the same start of the last stage, the cost that is reported only falls."""
    starts, costs = hands(generator, 5), []
    for rounds in (1, 2, 4, 8):
        stage = Stage(gross_m=0.01, rounds=rounds, iterations=2)
        costs.append(solve(problem(points), starts, (stage,)).cost)
    for before, after in itertools.pairwise(costs):
        assert bool((after <= before * (1 + 1e-12)).all())


def test_single_steps_go_on_until_the_next_one_promises_nothing(points: Points, generator: torch.Generator) -> None:
    """Each hypothesis takes as many as it needs, and ends where many more steps would end to a share of the cost."""
    near, far = hands(generator, spread=0.05), hands(generator, spread=0.6)
    starts = HandPose.stack([replace(near, reference=far.reference), far])

    def solved(rounds: int) -> Solutions:
        stage = Stage(gross_m=0.05, rounds=rounds, iterations=1, method="gauss_newton", until_arrived=True)
        return solve(problem(points, starts), starts, (stage,))

    few, some, many = (solved(rounds) for rounds in (1, 12, 24))
    assert few.iterations.tolist() == [1, 1]
    assert (some.iterations < 12).all()
    assert torch.equal(some.iterations, many.iterations)
    assert torch.equal(some.pose.dofs, many.pose.dofs)
    assert (some.status == SolveStatus.CONVERGED.value).all()
    assert (some.cost < 0.5 * few.cost).all()


def test_a_step_that_promises_little_is_the_last_and_believed(
    generator: torch.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is associated anew after it, and the cost that is told is nearly that of the hand which it led to."""
    joints = 0.5 * (MODEL.skeleton.lower + MODEL.skeleton.upper)  # far from the limits
    true = HandPose.stack([HandPose.of(torch.cat((torch.zeros(6), joints)).double(), torch.eye(3).double())])
    seen = problem(Points(points=_keypoints(true) + 0.005 * normal(generator, 1, 21, 3)))
    associations, associated = [], Points.associate

    def counted(self: Points, hands: PosedHands, stage: Stage) -> PointsFactor:
        associations.append(len(hands))
        return associated(self, hands, stage)

    monkeypatch.setattr(Points, "associate", counted)
    stage = Stage(gross_m=0.05, rounds=12, iterations=1, method="gauss_newton", until_arrived=True)
    single = replace(stage, rounds=1, until_arrived=False)
    start = solve(seen, true, (replace(single, rounds=4),)).pose
    of_start = solve(seen, start, (single,)).cost
    associations.clear()
    found = solve(seen, start, (stage,))
    assert associations == [1]
    assert found.iterations.tolist() == [1]
    assert found.status.tolist() == [SolveStatus.CONVERGED.value]
    again = solve(seen, found.pose, (single,))
    assert float(found.cost) == pytest.approx(float(again.cost), rel=0.01)
    assert float(again.cost) < float(of_start)


def test_a_failed_hypothesis_costs_infinitely_much_where_steps_are_believed(
    points: Points, generator: torch.Generator
) -> None:
    stage = Stage(gross_m=0.05, rounds=12, iterations=1, method="gauss_newton", until_arrived=True)
    start = hands(generator, 1)
    broken = replace(start, dofs=torch.full_like(start.dofs, torch.nan))
    found = solve(problem(points), HandPose.cat([broken, start]), (stage,))
    alone = solve(problem(points), broken, (stage,))
    assert found.cost.isinf().tolist() == [True, False]
    assert found.best == 1
    assert alone.cost.isinf().tolist() == [True]
    assert alone.status.tolist() == [SolveStatus.FAILED.value]


@dataclass(frozen=True, kw_only=True)
class Runaway:
    """Draws the hand along x to a place that is farther away the nearer the hand comes: every step is a loss."""

    target: Float[Tensor, "k"] = field(default_factory=lambda: torch.zeros(0, dtype=torch.float64))
    is_empty: bool = False

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "Runaway":
        return replace(self, target=self.target[rows] if len(self.target) else self.target)

    def associate(self, hands: PosedHands, stage: Stage) -> "Runaway":
        x = hands.pose.dofs[:, 0]
        return replace(self, target=2 * x + 1)

    def equations(self, hands: PosedHands) -> Equations:
        residual = (hands.pose.dofs[:, 0] - self.target)[:, None]
        rows = torch.eye(36, dtype=torch.float64)[None, :1].expand(len(hands), 1, 36)
        return Equations.of_rows(residual, torch.ones_like(residual), rows, 0.5 * residual.square().sum(-1))

    def explained(self) -> tuple[Explained, ...]:
        return ()


@pytest.mark.parametrize("method", ["levenberg_marquardt", "gauss_newton"])
def test_the_best_iterate_survives(method: str, generator: torch.Generator) -> None:
    """Where every association is worse than the one before, the start is the result."""
    starts = hands(generator, 3)
    starts.dofs[:, 0] = torch.tensor((0.1, 0.2, 0.3), dtype=torch.float64)
    planar = replace(problem(Runaway()), space=named_pose_space("planar").about(starts.dofs[0]), priors=())
    stage = Stage(gross_m=0.01, rounds=4, iterations=3)
    found = solve(planar, starts, (replace(stage, method=method),))
    torch.testing.assert_close(found.pose.dofs[:, 0], starts.dofs[:, 0])
    torch.testing.assert_close(found.cost, 0.5 * (starts.dofs[:, 0] + 1).square())
    assert bool((found.iterations > 0).all())


def test_what_cannot_be_solved_has_a_status(points: Points, generator: torch.Generator) -> None:
    """Not finite, or nothing in sight: the start, infinite cost, no covariance."""
    starts = hands(generator, 4)
    starts.dofs[0, 9], starts.dofs[1, 2] = torch.nan, torch.inf
    starts.dofs[2, 0] = 5.0
    found = solve(problem(points, starts), starts, SCHEDULE)
    assert found.status[:3].tolist() == [SolveStatus.FAILED] * 3
    assert found.status[3] in (SolveStatus.CONVERGED, SolveStatus.STALLED)
    assert bool(found.cost[:3].isinf().all())
    assert found.is_sound.tolist() == [False, False, False, True]
    assert bool(found.covariance[:3].isnan().all())
    torch.testing.assert_close(found.pose.dofs[:3], starts.dofs[:3], equal_nan=True)
    torch.testing.assert_close(found.pose.reference[2], starts.reference[2])
    assert found.best == 3


def test_without_data_the_start_is_returned(points: Points, generator: torch.Generator) -> None:
    starts = hands(generator, 2).about(torch.eye(3, dtype=torch.float64).expand(2, 3, 3))
    found = solve(problem(replace(points, is_empty=True), starts), starts, SCHEDULE)
    assert found.status.tolist() == [SolveStatus.NO_DATA] * 2
    assert bool(found.cost.isinf().all())
    assert not bool(found.iterations.any())
    assert found.explained == ()
    torch.testing.assert_close(found.pose.rotation, starts.rotation)
    torch.testing.assert_close(found.pose.dofs, starts.normalized().dofs)
    none = solve(problem(points), hands(generator, 0), SCHEDULE)
    assert none.pose.batch_shape == (0,)
    with pytest.raises(ValueError, match="schedule: expected at least one stage"):
        solve(problem(points), starts, ())


def test_limits_hold_whatever_the_data_want(generator: torch.Generator) -> None:
    """Keypoints of fingers that bend the wrong way; starts beyond the limits are put within."""
    wrong = hands(generator, 1)
    wrong.dofs[:, 6:] = MODEL.skeleton.lower - 0.8
    starts = hands(generator, 4)
    starts.dofs[:2, INDEX] = 9.0
    found = solve(problem(Points(points=_keypoints(wrong))), starts, SCHEDULE)
    assert bool(found.is_sound.all())
    assert bool((found.pose.dofs[:, 6:] >= MODEL.skeleton.lower - 1e-12).all())
    assert bool((found.pose.dofs[:, 6:] <= MODEL.skeleton.upper + 1e-12).all())
    assert bool((found.pose.dofs[:, 6:] == MODEL.skeleton.lower).any())


def test_a_hypothesis_that_nothing_determines_has_no_covariance(generator: torch.Generator) -> None:
    factor = normal(generator, 4, 5, 5)
    matrix = factor @ factor.mT + torch.eye(5, dtype=torch.float64)
    matrix[1, 2], matrix[1, :, 2] = 0.0, 0.0  # singular
    matrix[2, 0, 0] = torch.nan
    found = covariance_of(matrix, torch.tensor([True, True, False, True]))
    assert bool(found[1:3].isnan().all())
    torch.testing.assert_close(found[[0, 3]], torch.linalg.inv(matrix[[0, 3]]), atol=1e-9, rtol=1e-9)
