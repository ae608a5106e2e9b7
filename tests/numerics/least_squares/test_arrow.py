"""An arrow of normal equations: what is left after elimination is the Schur complement of the dense matrix."""

import pytest
import torch
from torch import Tensor

from torchhand.numerics.least_squares import ArrowEquations

FRAMES, OWN, SHARED = 4, 3, 2


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
def test_the_shared_step_is_that_of_the_dense_matrix(seed: int) -> None:
    """And so are the steps of the blocks that follow."""
    rows, residual = _random_rows(seed)
    dense = torch.linalg.solve(rows.T @ rows, -(rows.T @ residual))
    left = _equations(rows, residual).eliminated()
    step = torch.linalg.solve(left.equations.matrix, -left.equations.gradient)
    torch.testing.assert_close(step, dense[-SHARED:], rtol=1e-9, atol=1e-9)
    own = torch.stack([-torch.linalg.lstsq(r[:, n], residual[k]).solution for r, n, k in _each(rows)])
    followed = own + left.follow @ step
    # An entry of 1e-12 is added to the diagonal, which a block that is nearly singular amplifies.
    torch.testing.assert_close(followed.flatten(), dense[:-SHARED], rtol=1e-7, atol=1e-7)


def _each(rows: Tensor) -> list[tuple[Tensor, slice, slice]]:
    """The rows of every frame, the columns of its own unknowns, and its places among the residuals."""
    own = [slice(6 * frame, 6 * frame + 6) for frame in range(FRAMES)]
    return [(rows[k], slice(OWN * i, OWN * (i + 1)), k) for i, k in enumerate(own)]


def test_fixed_unknowns_do_not_follow() -> None:
    """As if its columns were not there."""
    rows, residual = _random_rows(7)
    fixed = torch.zeros(FRAMES, OWN, dtype=torch.bool)
    fixed[1, 2] = fixed[3] = True
    left = _equations(rows, residual).eliminated(fixed)
    without = rows.clone()
    without[:, :-SHARED] *= ~fixed.flatten()
    is_open = torch.cat((~fixed.flatten(), torch.ones(SHARED, dtype=torch.bool)))
    dense = (without.T @ without)[is_open][:, is_open]
    step = torch.linalg.solve(dense, -(without.T @ residual)[is_open])[-SHARED:]
    torch.testing.assert_close(
        torch.linalg.solve(left.equations.matrix, -left.equations.gradient), step, rtol=1e-9, atol=1e-9
    )
    assert not left.follow[fixed].any()


def test_blocks_without_influence_follow_nothing() -> None:
    rows, residual = _random_rows(8)
    rows[:, :OWN] = 0
    left = _equations(rows, residual).eliminated()
    assert not left.follow[0].any()
    assert bool(left.equations.matrix.isfinite().all())


def test_parts_make_the_whole() -> None:
    (rows, residual), (others, other) = _random_rows(9), _random_rows(10)
    one, two = _equations(rows, residual), _equations(others, other)
    both, left = ArrowEquations.cat((one, two)).eliminated(), [part.eliminated() for part in (one, two)]
    for name in ("matrix", "gradient", "cost"):
        expected = sum(getattr(part.equations, name) for part in left)
        torch.testing.assert_close(getattr(both.equations, name), expected, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(both.follow, torch.cat([part.follow for part in left]), rtol=1e-12, atol=1e-12)
