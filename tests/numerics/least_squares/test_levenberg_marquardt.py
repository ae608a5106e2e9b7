"""Levenberg-Marquardt against least squares in closed form, against scipy, and problem by problem."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.optimize
import torch
from torch import Tensor

from torchhand import devices
from torchhand.numerics.least_squares.box_step import after_box_step, damped_box_step
from torchhand.numerics.least_squares.levenberg_marquardt import levenberg_marquardt
from torchhand.numerics.least_squares.records import LevenbergMarquardtSettings, NormalEquations, Status
from torchhand.numerics.least_squares.robust import RobustLoss

DOUBLE = torch.float64


def rosenbrock(values: Tensor) -> tuple[Tensor, Tensor]:
    x, y = values.unbind(-1)
    zero = torch.zeros_like(x)
    residual = torch.stack((10 * (y - x * x), 1 - x), -1)
    jacobian = torch.stack((-20 * x, zero + 10, zero - 1, zero), -1).unflatten(-1, (2, 2))
    return residual, jacobian


class Curves:
    """Fits of a exp(-b t) + c sin(d t) to noisy data: one set of data per problem."""

    def __init__(self, problems: int, *, samples: int = 40, seed: int = 0) -> None:
        generator = torch.Generator().manual_seed(seed)
        self.times = torch.linspace(0, 3, samples, dtype=DOUBLE)
        truth = torch.tensor((2.0, 1.5, 0.7, 2.0), dtype=DOUBLE)
        self.truth = truth * (1 + 0.2 * torch.randn(problems, 4, generator=generator, dtype=DOUBLE))
        noise = torch.randn(problems, samples, generator=generator, dtype=DOUBLE)
        self.start = self.truth * (1 + 0.1 * torch.randn(problems, 4, generator=generator, dtype=DOUBLE))
        self.data = self.model(self.truth) + 0.05 * noise

    def model(self, values: Tensor) -> Tensor:
        a, b, c, d = (value[..., None] for value in values.unbind(-1))
        return a * torch.exp(-b * self.times) + c * torch.sin(d * self.times)

    def __call__(self, values: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        a, b, c, d = (value[..., None] for value in values.unbind(-1))
        decay, sine, cosine = torch.exp(-b * self.times), torch.sin(d * self.times), torch.cos(d * self.times)
        jacobian = torch.stack((decay, -a * self.times * decay, sine, c * self.times * cosine), -1)
        return self.model(values) - self.data[rows], jacobian

    def one(self, row: int) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
        return lambda values: self(values, torch.tensor(row))


def scipy_values(problem: Callable[[Tensor], tuple[Tensor, Tensor]], start: Tensor, **options: object) -> np.ndarray:
    found = scipy.optimize.least_squares(
        lambda x: problem(torch.from_numpy(x))[0].numpy(),
        start.numpy(),
        jac=lambda x: problem(torch.from_numpy(x))[1].numpy(),  # type: ignore[arg-type]
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        **options,  # type: ignore[arg-type]
    )
    return found.x


def test_a_linear_problem_is_solved_in_one_step(generator: torch.Generator) -> None:
    matrix = torch.randn(2, 3, 12, 5, generator=generator, dtype=DOUBLE)
    right = torch.randn(2, 3, 12, generator=generator, dtype=DOUBLE)

    def linear(values: Tensor) -> tuple[Tensor, Tensor]:
        return (matrix @ values[..., None]).squeeze(-1) - right, matrix

    settings = LevenbergMarquardtSettings(iterations=1, damping=1e-14)
    found = levenberg_marquardt(linear, torch.zeros(2, 3, 5, dtype=DOUBLE), settings=settings)
    expected = torch.linalg.lstsq(matrix, right[..., None]).solution.squeeze(-1)
    torch.testing.assert_close(found.values, expected, atol=1e-10, rtol=0)
    torch.testing.assert_close(found.matrix, matrix.mT @ matrix, atol=1e-12, rtol=0)
    torch.testing.assert_close(found.gradient, torch.zeros_like(expected), atol=1e-9, rtol=0)


def test_rosenbrock_from_many_starts(generator: torch.Generator) -> None:
    start = 3 * torch.randn(50, 2, generator=generator, dtype=DOUBLE)
    found = levenberg_marquardt(rosenbrock, start, settings=LevenbergMarquardtSettings(iterations=200))
    assert bool(found.converged.all())
    torch.testing.assert_close(found.values, torch.ones(50, 2, dtype=DOUBLE), atol=1e-8, rtol=0)


def test_agrees_with_scipy() -> None:
    curves = Curves(6)
    found = levenberg_marquardt(curves, curves.start, takes_rows=True)
    assert bool(found.converged.all())
    for row in range(6):
        expected = scipy_values(curves.one(row), curves.start[row])
        np.testing.assert_allclose(found.values[row].numpy(), expected, atol=1e-6)


def test_active_bounds_agree_with_scipy() -> None:
    """Bounds that cut off the free optimum, on different variables of different problems."""
    curves = Curves(8, seed=3)
    free = levenberg_marquardt(curves, curves.start, takes_rows=True).values
    lower, upper = free - 1.0, free + 1.0
    for row in range(8):
        if row % 2:
            lower[row, row % 4] = free[row, row % 4] + 0.1
        else:
            upper[row, row % 4] = free[row, row % 4] - 0.1
    seen: list[Tensor] = []

    def watched(values: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        seen.append(((values >= lower[rows]) & (values <= upper[rows])).all())
        return curves(values, rows)

    found = levenberg_marquardt(watched, curves.start, lower=lower, upper=upper, takes_rows=True)
    assert all(bool(inside) for inside in seen)
    assert bool(found.converged.all())
    assert found.on_bound.sum(-1).ge(1).all()
    for row in range(8):
        start = curves.start[row].clamp(lower[row] + 1e-6, upper[row] - 1e-6)
        expected = scipy_values(curves.one(row), start, bounds=(lower[row].numpy(), upper[row].numpy()))
        np.testing.assert_allclose(found.values[row].numpy(), expected, atol=2e-6)


def test_a_start_outside_is_put_inside_and_equal_bounds_hold_a_variable() -> None:
    lower, upper = torch.tensor((0.5, -5.0), dtype=DOUBLE), torch.tensor((0.5, 5.0), dtype=DOUBLE)
    found = levenberg_marquardt(rosenbrock, torch.tensor((9.0, 9.0), dtype=DOUBLE), lower=lower, upper=upper)
    assert found.status == Status.CONVERGED
    torch.testing.assert_close(found.values, torch.tensor((0.5, 0.25), dtype=DOUBLE), atol=1e-6, rtol=0)
    assert found.on_bound.tolist() == [True, False]


def test_a_problem_without_numbers_harms_no_other() -> None:
    curves = Curves(5)
    good = levenberg_marquardt(curves, curves.start, takes_rows=True)
    curves.data[2, 7] = torch.nan
    found = levenberg_marquardt(curves, curves.start, takes_rows=True)
    assert found.status.tolist() == [0, 0, int(Status.FAILED), 0, 0]
    torch.testing.assert_close(found.values[2], curves.start[2], atol=0, rtol=0)
    others = torch.tensor((0, 1, 3, 4))
    torch.testing.assert_close(found.values[others], good.values[others], atol=1e-12, rtol=0)


def test_a_trial_without_numbers_is_refused() -> None:
    """The square root ends at 0: the first Gauss-Newton step leads beyond."""

    def root(values: Tensor) -> tuple[Tensor, Tensor]:
        return values.sqrt() - 0.5, (0.5 / values.sqrt())[..., None]

    found = levenberg_marquardt(root, torch.full((1,), 9.0, dtype=DOUBLE))
    assert found.status == Status.CONVERGED
    assert abs(float(found.values) - 0.25) < 1e-9


def test_a_wrong_derivative_stalls_at_the_start() -> None:
    def wrong(values: Tensor) -> tuple[Tensor, Tensor]:
        residual, jacobian = rosenbrock(values)
        return residual, -jacobian

    start = torch.tensor((-1.2, 1.0), dtype=DOUBLE)
    found = levenberg_marquardt(wrong, start)
    assert found.status == Status.STALLED
    torch.testing.assert_close(found.values, start, atol=0, rtol=0)


def test_out_of_iterations_gives_the_best_so_far() -> None:
    start = torch.tensor((-1.2, 1.0), dtype=DOUBLE)
    found = levenberg_marquardt(rosenbrock, start, settings=LevenbergMarquardtSettings(iterations=3))
    assert found.status == Status.STALLED
    assert found.iterations == 3
    assert float(found.cost) < float(rosenbrock(start)[0].square().sum() / 2)
    torch.testing.assert_close(found.cost, rosenbrock(found.values)[0].square().sum() / 2, atol=1e-15, rtol=0)


@pytest.mark.parametrize("takes_rows", [True, False])
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_single_problems(batch: tuple[int, ...], takes_rows: bool) -> None:
    count = int(torch.tensor(batch).prod()) if batch else 1
    curves = Curves(count, seed=1)
    curves.start[count // 2] = 1.001 * curves.truth[count // 2]  # done early, dropped early
    rows = torch.arange(count).reshape(batch)

    def whole(values: Tensor) -> tuple[Tensor, Tensor]:
        return curves(values, rows)

    start = curves.start.reshape(*batch, 4)
    lower, upper = 0.95 * curves.truth.reshape(*batch, 4), torch.full((4,), torch.inf, dtype=DOUBLE)
    found = levenberg_marquardt(curves if takes_rows else whole, start, lower=lower, upper=upper, takes_rows=takes_rows)
    for row in range(count):
        alone = levenberg_marquardt(curves.one(row), curves.start[row], lower=0.95 * curves.truth[row], upper=upper)
        assert alone.status == found.status.reshape(-1)[row]
        assert alone.iterations == found.iterations.reshape(-1)[row]
        torch.testing.assert_close(found.values.reshape(-1, 4)[row], alone.values, atol=1e-12, rtol=0)
        torch.testing.assert_close(found.cost.reshape(-1)[row], alone.cost, atol=1e-12, rtol=0)
        torch.testing.assert_close(found.matrix.reshape(-1, 4, 4)[row], alone.matrix, atol=1e-10, rtol=0)


def test_problems_that_are_done_are_not_evaluated_any_more() -> None:
    curves = Curves(20)
    curves.start[3:] = curves.truth[3:]
    counts: list[int] = []

    def counted(values: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        counts.append(len(rows))
        return curves(values, rows)

    levenberg_marquardt(counted, curves.start, takes_rows=True)
    assert counts[0] == 20
    assert counts[-1] < 10


def test_normal_equations_give_the_same() -> None:
    curves = Curves(4)

    def normal(values: Tensor, rows: Tensor) -> NormalEquations:
        residual, jacobian = curves(values, rows)
        return NormalEquations(
            matrix=jacobian.mT @ jacobian,
            gradient=(jacobian.mT @ residual[..., None]).squeeze(-1),
            cost=0.5 * residual.square().sum(-1),
        )

    found = levenberg_marquardt(normal, curves.start, takes_rows=True)
    expected = levenberg_marquardt(curves, curves.start, takes_rows=True)
    torch.testing.assert_close(found.values, expected.values, atol=1e-13, rtol=0)


@pytest.mark.parametrize(("kind", "loss"), [("huber", "huber"), ("geman_mcclure", None)])
def test_robust_losses_agree_with_scipy(kind: str, loss: str | None) -> None:
    curves = Curves(3)
    curves.data[:, ::9] += 2.0
    robust = RobustLoss(kind="huber" if kind == "huber" else "geman_mcclure", scale=0.2)
    settings = LevenbergMarquardtSettings(iterations=500, cost_tolerance=1e-14)
    found = levenberg_marquardt(curves, curves.start, robust=robust, takes_rows=True, settings=settings)
    assert (found.values - curves.truth).abs().max() < 0.2
    plain = levenberg_marquardt(curves, curves.start, takes_rows=True)
    assert (plain.values - curves.truth).abs().max() > 0.3

    def geman_mcclure(squared: np.ndarray) -> np.ndarray:
        return np.stack([squared / (1 + squared), (1 + squared) ** -2, -2 * (1 + squared) ** -3])

    for row in range(3):
        options = {"loss": loss or geman_mcclure, "f_scale": 0.2}
        expected = scipy_values(curves.one(row), found.values[row] + 0.01, **options)
        np.testing.assert_allclose(found.values[row].numpy(), expected, atol=1e-4)


def test_weights_are_the_derivative_of_the_loss(generator: torch.Generator) -> None:
    for kind in ("squares", "huber", "geman_mcclure"):
        robust = RobustLoss(kind=kind, scale=0.7, group=3)
        residual = torch.randn(4, 6, generator=generator, dtype=DOUBLE).requires_grad_()
        cost, weights = robust.cost_and_weights(residual)
        (gradient,) = torch.autograd.grad(cost.sum(), residual)
        torch.testing.assert_close(gradient, weights * residual, atol=1e-12, rtol=0)
        small = 1e-4 * residual.detach()
        torch.testing.assert_close(robust.cost_and_weights(small)[0], 0.5 * small.square().sum(-1), atol=1e-14, rtol=0)


def test_a_variable_without_influence_stays() -> None:
    def problem(values: Tensor) -> tuple[Tensor, Tensor]:
        jacobian = torch.zeros(*values.shape[:-1], 1, 2, dtype=DOUBLE)
        jacobian[..., 0, 0] = 1
        return values[..., :1] - 3, jacobian

    found = levenberg_marquardt(problem, torch.tensor((0.0, 7.0), dtype=DOUBLE))
    assert found.status == Status.CONVERGED
    torch.testing.assert_close(found.values, torch.tensor((3.0, 7.0), dtype=DOUBLE), atol=1e-8, rtol=0)


def test_single_precision_converges() -> None:
    found = levenberg_marquardt(rosenbrock, torch.tensor([[-1.2, 1.0], [2.0, 2.0]]))
    assert found.values.dtype == torch.float32
    assert bool(found.converged.all())
    torch.testing.assert_close(found.values, torch.ones(2, 2), atol=1e-4, rtol=0)


def test_the_box_step_meets_the_optimality_conditions(generator: torch.Generator) -> None:
    """Without damping: free variables have no gradient left, pinned ones are driven outwards."""
    root = torch.randn(200, 7, 5, generator=generator, dtype=DOUBLE)
    matrix, gradient = root.mT @ root, torch.randn(200, 5, generator=generator, dtype=DOUBLE)
    below, above = -0.05 * torch.rand(200, 5, generator=generator, dtype=DOUBLE), torch.full((200, 5), torch.inf)
    step, is_solved = damped_box_step(matrix, gradient, torch.zeros(200, dtype=DOUBLE), below, above.to(DOUBLE))
    assert bool(is_solved.all())
    assert bool((step >= below).all())
    slope = gradient + (matrix @ step[..., None]).squeeze(-1)
    is_free = step > below
    assert float(slope[is_free].abs().max()) < 1e-8
    assert float((slope[~is_free] > 0).double().mean()) > 0.8
    singular = torch.zeros(1, 2, 2, dtype=DOUBLE)
    singular[0, 0, 0] = -1.0
    step, is_solved = damped_box_step(singular, torch.ones(1, 2, dtype=DOUBLE), torch.ones(1, dtype=DOUBLE), None, None)
    assert not bool(is_solved)
    assert float(step.abs().max()) == 0


def test_a_step_to_a_bound_ends_on_it(generator: torch.Generator) -> None:
    """Not a last bit beside it, where a variable counts as free, or as one that does not move."""
    low, high = (
        -torch.rand(500, 6, generator=generator, dtype=DOUBLE),
        torch.rand(500, 6, generator=generator, dtype=DOUBLE),
    )
    values = low + (high - low) * torch.rand(500, 6, generator=generator, dtype=DOUBLE)
    to_low, to_high = low - values, high - values
    is_beside = (values + to_low != low) | (values + to_high != high)
    assert 0.05 < float(is_beside.double().mean()) < 0.9
    assert torch.equal(after_box_step(values, to_low, low, high), low)
    assert torch.equal(after_box_step(values, to_high, low, high), high)
    assert torch.equal(after_box_step(values, 0.5 * to_low, low, high), values + 0.5 * to_low)
    unbounded = torch.full((6,), torch.inf, dtype=DOUBLE)
    assert torch.equal(after_box_step(values, to_high, -unbounded, unbounded), values + to_high)


def test_error_messages() -> None:
    with pytest.raises(ValueError, match="damping: expected above 0 and below max_damping"):
        LevenbergMarquardtSettings(damping=0.0)
    with pytest.raises(ValueError, match="iterations: expected 1 or more, got 0"):
        LevenbergMarquardtSettings(iterations=0)
    with pytest.raises(ValueError, match="cost_tolerance: expected 0 or more and finite, got -1"):
        LevenbergMarquardtSettings(cost_tolerance=-1.0)
    with pytest.raises(ValueError, match=r"robust\.scale: expected above 0 and finite, got 0"):
        RobustLoss(scale=0.0)
    with pytest.raises(ValueError, match=r"robust\.group: expected 1 or more, got 0"):
        RobustLoss(group=0)
    with pytest.raises(ValueError, match="expected a multiple of 3 numbers, got 4"):
        RobustLoss(group=3).cost_and_weights(torch.zeros(4))
    start = torch.zeros(2, dtype=DOUBLE)
    with pytest.raises(ValueError, match="bounds: expected both or neither"):
        levenberg_marquardt(rosenbrock, start, lower=start)
    with pytest.raises(ValueError, match="bounds: expected lower <= upper"):
        levenberg_marquardt(rosenbrock, start, lower=start + 1, upper=start)


@pytest.mark.parametrize("turns", [1, 8])
def test_what_is_asked_seldom_comes_out_the_same(turns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """An accelerator goes on with problems that are done, drops them later, and solves for all what few need."""
    curves = Curves(40)
    lower, upper = curves.start - 0.02, curves.start + 0.03  # many of the values end on one
    expected = levenberg_marquardt(curves, curves.start, takes_rows=True, lower=lower, upper=upper)
    monkeypatch.setattr(devices, "_HOSTS", ())
    monkeypatch.setattr(devices, "TURNS", turns)
    found = levenberg_marquardt(curves, curves.start, takes_rows=True, lower=lower, upper=upper)
    assert bool(expected.on_bound.any(-1).all())
    assert len(expected.iterations.unique()) > 3
    for name in ("status", "iterations", "on_bound"):
        assert torch.equal(getattr(found, name), getattr(expected, name))
    torch.testing.assert_close(found.values, expected.values, rtol=1e-12, atol=1e-12)
