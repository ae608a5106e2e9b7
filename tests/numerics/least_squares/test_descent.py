"""Gradient descent: minima in closed form, within bounds, problem by problem; and a known first linearisation in LM."""

import numpy as np
import pytest
import scipy.optimize
import torch
from torch import Tensor

from torchhand.numerics.least_squares.descent import DescentSettings, gradient_descent
from torchhand.numerics.least_squares.levenberg_marquardt import levenberg_marquardt
from torchhand.numerics.least_squares.records import NormalEquations, Status, normal_equations
from torchhand.numerics.least_squares.robust import RobustLoss

DOUBLE = torch.float64


class Linear:
    """|A x - b|², one A and b per problem."""

    def __init__(self, generator: torch.Generator, *batch: int) -> None:
        self.matrix = torch.randn(*batch, 8, 3, generator=generator, dtype=DOUBLE) * torch.tensor((1.0, 5.0, 0.1))
        self.target = torch.randn(*batch, 8, generator=generator, dtype=DOUBLE)

    def __call__(self, values: Tensor) -> tuple[Tensor, Tensor]:
        return (self.matrix @ values[..., None]).squeeze(-1) - self.target, self.matrix

    @property
    def solution(self) -> Tensor:
        return torch.linalg.lstsq(self.matrix, self.target[..., None]).solution.squeeze(-1)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_finds_the_least_squares_solution(batch: tuple[int, ...], generator: torch.Generator) -> None:
    problem = Linear(generator, *batch)
    settings = DescentSettings(iterations=3000, cost_tolerance=1e-15)
    found = gradient_descent(problem, torch.zeros(*batch, 3, dtype=DOUBLE), settings=settings)
    torch.testing.assert_close(found.values, problem.solution, atol=1e-4, rtol=1e-4)
    newton = levenberg_marquardt(problem, torch.zeros(*batch, 3, dtype=DOUBLE))
    torch.testing.assert_close(found.cost, newton.cost, atol=1e-8, rtol=0)
    torch.testing.assert_close(found.matrix, newton.matrix)


def test_stays_within_bounds_and_says_which_hold(generator: torch.Generator) -> None:
    problem = Linear(generator, 4)
    lower, upper = problem.solution + 0.1, torch.full((3,), torch.inf, dtype=DOUBLE)
    found = gradient_descent(
        problem, lower + 1, lower=lower, upper=upper, settings=DescentSettings(iterations=5000, cost_tolerance=0.0)
    )
    assert bool((found.values >= lower).all())
    assert bool(found.on_bound.any())
    for i in range(4):
        arrays = [x[i].numpy() for x in (problem.matrix, problem.target, lower)]
        exact = scipy.optimize.lsq_linear(arrays[0], arrays[1], bounds=(arrays[2], np.inf))
        assert float(found.cost[i]) == pytest.approx(exact.cost, abs=1e-6)


def test_never_gets_worse_and_one_problem_never_touches_another(generator: torch.Generator) -> None:
    problem = Linear(generator, 3)
    start = torch.ones(3, 3, dtype=DOUBLE)
    start[1] = torch.nan
    begun = 0.5 * problem(start)[0].square().sum(-1)
    for iterations in (1, 2, 5):
        found = gradient_descent(problem, start, settings=DescentSettings(iterations=iterations))
        assert bool((found.cost[[0, 2]] <= begun[[0, 2]]).all())
        assert found.status[1] == Status.FAILED
    alone = Linear(generator, 1)
    alone.matrix, alone.target = problem.matrix[2:], problem.target[2:]
    single = gradient_descent(alone, start[2:], settings=DescentSettings(iterations=5))
    torch.testing.assert_close(single.values[0], found.values[2])


def test_robust_loss_and_rows(generator: torch.Generator) -> None:
    """Median-like with Huber: one gross error hardly moves the mean of many."""
    data = torch.tensor([[0.0, 0.1, -0.1, 0.05, 50.0], [1.0, 1.1, 0.9, 1.0, 1.0]], dtype=DOUBLE)

    def linearise(values: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        return values - data[rows], torch.ones(len(rows), 5, 1, dtype=DOUBLE)

    found = gradient_descent(
        linearise,
        torch.full((2, 1), 5.0, dtype=DOUBLE),
        robust=RobustLoss(kind="huber", scale=0.1),
        settings=DescentSettings(iterations=400),
        takes_rows=True,
    )
    assert abs(float(found.values[0, 0])) < 0.1
    assert abs(float(found.values[1, 0]) - 1) < 1e-3
    assert found.status.tolist() == [Status.CONVERGED, Status.CONVERGED]


def test_scale_makes_units_equal(generator: torch.Generator) -> None:
    """Given the true scales, it is as quick as with its own."""
    problem = Linear(generator)
    scale = (problem.matrix.square().sum(0)).rsqrt()
    settings = DescentSettings(iterations=60)
    own = gradient_descent(problem, torch.zeros(3, dtype=DOUBLE), settings=settings)
    given = gradient_descent(problem, torch.zeros(3, dtype=DOUBLE), scale=scale, settings=settings)
    torch.testing.assert_close(own.values, given.values)


@pytest.mark.parametrize(
    ("field", "value"), [("iterations", 0), ("rate", 0.0), ("growth", 0.5), ("shrink", 1.0), ("cost_tolerance", -1.0)]
)
def test_settings_say_what_is_wrong(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{field}: expected"):
        DescentSettings(**{field: value})  # type: ignore[arg-type]


def test_bounds_are_checked(generator: torch.Generator) -> None:
    problem, one = Linear(generator), torch.ones(3, dtype=DOUBLE)
    with pytest.raises(ValueError, match="both or neither"):
        gradient_descent(problem, one, lower=one)
    with pytest.raises(ValueError, match="lower <= upper"):
        gradient_descent(problem, one, lower=one, upper=-one)


def test_levenberg_marquardt_begins_with_what_is_known(generator: torch.Generator) -> None:
    """The same result, with one evaluation less."""
    problem, calls = Linear(generator, 2), []

    def counted(values: Tensor) -> tuple[Tensor, Tensor]:
        calls.append(1)
        return problem(values)

    start = torch.zeros(2, 3, dtype=DOUBLE)
    plain = levenberg_marquardt(counted, start)
    count = len(calls)
    first: NormalEquations = normal_equations(problem(start), None)
    known = levenberg_marquardt(counted, start, first=first)
    assert len(calls) == 2 * count - 1
    torch.testing.assert_close(known.values, plain.values)
