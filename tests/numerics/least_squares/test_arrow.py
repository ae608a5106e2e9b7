"""An arrow of normal equations: the step is that of the dense matrix, and the optimiser finds a constrained minimum."""

import pytest
import torch
from torch import Tensor

from torchhand.numerics.least_squares import (
    ArrowEquations,
    ArrowValues,
    LevenbergMarquardtSettings,
    Status,
    arrow_levenberg_marquardt,
    damped_arrow_step,
    damped_box_step,
)

FRAMES, OWN, SHARED = 4, 3, 2


def _whole(values: ArrowValues) -> Tensor:
    return torch.cat((values.blocks.flatten(), values.shared))


def _parts(whole: Tensor) -> ArrowValues:
    return ArrowValues(blocks=whole[:-SHARED].unflatten(0, (FRAMES, OWN)), shared=whole[-SHARED:])


def _random_rows(seed: int) -> tuple[Tensor, Tensor]:
    """Rows of a linear problem in which each frame's residuals depend on its own unknowns and the shared ones."""
    generator = torch.Generator().manual_seed(seed)
    rows = torch.zeros(FRAMES * 6, FRAMES * OWN + SHARED, dtype=torch.float64)
    for frame in range(FRAMES):
        own = slice(6 * frame, 6 * frame + 6)
        rows[own, OWN * frame : OWN * (frame + 1)] = torch.randn(6, OWN, generator=generator, dtype=torch.float64)
        rows[own, -SHARED:] = torch.randn(6, SHARED, generator=generator, dtype=torch.float64)
    return rows, torch.randn(FRAMES * 6, generator=generator, dtype=torch.float64)


def _equations(rows: Tensor, residual: Tensor) -> ArrowEquations:
    matrix, gradient = rows.T @ rows, rows.T @ residual
    count = FRAMES * OWN
    blocks = matrix[:count, :count].unflatten(0, (FRAMES, OWN)).unflatten(2, (FRAMES, OWN))
    return ArrowEquations(
        blocks=torch.stack([blocks[frame, :, frame] for frame in range(FRAMES)]),
        mixed=matrix[:count, count:].unflatten(0, (FRAMES, OWN)),
        shared=matrix[count:, count:],
        block_gradient=gradient[:count].unflatten(0, (FRAMES, OWN)),
        shared_gradient=gradient[count:],
        cost=0.5 * residual.square().sum(),
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("room", [torch.inf, 0.3, 0.05])
def test_the_step_is_that_of_the_dense_matrix(seed: int, room: float) -> None:
    rows, residual = _random_rows(seed)
    equations, damping = _equations(rows, residual), 0.1
    rooms = torch.full((FRAMES * OWN + SHARED,), room, dtype=torch.float64)
    # A damping relative to the diagonal of the whole is one relative to those of the parts.
    expected, _ = damped_box_step(
        (rows.T @ rows)[None],
        (rows.T @ residual)[None],
        torch.full((1,), damping, dtype=torch.float64),
        -rooms[None],
        rooms[None],
    )
    found = damped_arrow_step(equations, damping, _parts(-rooms), _parts(rooms))
    assert torch.allclose(_whole(found), expected[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_linear_problem_ends_at_its_minimum(seed: int) -> None:
    rows, wanted = _random_rows(seed)

    def linearise(values: ArrowValues) -> ArrowEquations:
        return _equations(rows, rows @ _whole(values) - wanted)

    unbounded = torch.full((FRAMES * OWN + SHARED,), torch.inf, dtype=torch.float64)
    start = _parts(torch.zeros_like(unbounded))
    found = arrow_levenberg_marquardt(
        linearise, start, _parts(-unbounded), _parts(unbounded), LevenbergMarquardtSettings()
    )
    expected = torch.linalg.lstsq(rows, wanted[:, None]).solution[:, 0]
    assert found.status is Status.CONVERGED
    assert torch.allclose(_whole(found.values), expected, rtol=0, atol=1e-6)


def test_bounds_hold_and_no_feasible_direction_lowers_the_cost() -> None:
    rows, wanted = _random_rows(7)
    bound = torch.full((FRAMES * OWN + SHARED,), 0.2, dtype=torch.float64)

    def linearise(values: ArrowValues) -> ArrowEquations:
        return _equations(rows, rows @ _whole(values) - wanted)

    found = arrow_levenberg_marquardt(
        linearise, _parts(torch.zeros_like(bound)), _parts(-bound), _parts(bound), LevenbergMarquardtSettings()
    )
    values = _whole(found.values)
    gradient = rows.T @ (rows @ values - wanted)
    inner = values.abs() < bound
    assert bool((values.abs() <= bound).all())
    assert bool((~inner).any())
    assert float(gradient[inner].abs().max()) < 1e-5
    assert bool((gradient[~inner] * values[~inner].sign() <= 1e-5).all())


def test_a_cost_that_is_no_number_at_the_start_has_failed() -> None:
    rows, wanted = _random_rows(0)

    def linearise(values: ArrowValues) -> ArrowEquations:
        return _equations(rows, (rows @ _whole(values) - wanted) * torch.nan)

    bound = torch.full((FRAMES * OWN + SHARED,), 1.0, dtype=torch.float64)
    start = _parts(torch.zeros_like(bound))
    found = arrow_levenberg_marquardt(linearise, start, _parts(-bound), _parts(bound), LevenbergMarquardtSettings())
    assert found.status is Status.FAILED
    assert torch.equal(_whole(found.values), _whole(start))
