"""Nearest points of polytopes against Dykstra's alternating projections and plain clamping."""

import pytest
import torch
from torch import Tensor

from torchhand.numerics.polytope import Polytope, polytope

LOWER, UPPER = torch.tensor((-1.0, -0.5, 0.0)).double(), torch.tensor((1.0, 1.5, 2.0)).double()
MATRIX = torch.tensor(((1.0, -1.0, 0.0), (0.0, 1.0, -1.0), (1.0, 2.0, 3.0))).double()
BOUND = torch.tensor((0.4, 0.3, 4.0)).double()


@pytest.fixture(scope="module")
def small() -> Polytope:
    return polytope(LOWER, UPPER, MATRIX, BOUND)


def _dykstra(point: Tensor, matrix: Tensor, bound: Tensor, rounds: int = 3000) -> Tensor:
    """Projections onto one half space after the other, each after giving back what that one took before."""
    point = point.clone()
    taken = torch.zeros(len(matrix), *point.shape, dtype=point.dtype)
    for _ in range(rounds):
        for row, (normal, side) in enumerate(zip(matrix, bound, strict=True)):
            start = point + taken[row]
            step = (start @ normal - side).clamp_min(0) / (normal @ normal)
            point = start - step[..., None] * normal
            taken[row] = start - point
    return point


def test_is_the_nearest_point(small: Polytope, generator: torch.Generator) -> None:
    points = 3 * torch.randn(100, 3, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(small.nearest(points), _dykstra(points, small.matrix, small.bound), atol=1e-9, rtol=0)


def test_box_is_clamping(generator: torch.Generator) -> None:
    box = polytope(LOWER, UPPER, torch.zeros(0, 3).double(), torch.zeros(0).double())
    points = 3 * torch.randn(50, 3, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(box.nearest(points), points.clamp(LOWER, UPPER), atol=1e-15, rtol=0)
    assert len(box.flatten) == 27


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_feasible_and_idempotent(small: Polytope, generator: torch.Generator, dtype: torch.dtype) -> None:
    reach = 10 * torch.rand(5000, 1, generator=generator, dtype=dtype)
    points = reach * torch.randn(5000, 3, generator=generator, dtype=dtype)
    near = small.nearest(points)
    assert near.dtype == dtype
    # measured in float64: in float32 the sum alone may be off by one unit in the last place of its terms
    assert float(small.excess(near.double()).max()) < (3e-7 if dtype == torch.float32 else 1e-12)
    assert torch.equal(small.nearest(near), near)
    inside = points[(small.excess(points) <= 0).all(-1)]
    assert len(inside) > 5
    assert torch.equal(small.nearest(inside), inside)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (0,)])
def test_batches(small: Polytope, generator: torch.Generator, batch: tuple[int, ...]) -> None:
    points = 2 * torch.randn(*batch, 3, generator=generator, dtype=torch.float64)
    loop = [small.nearest(point) for point in points.reshape(-1, 3)]
    expected = torch.stack(loop).reshape(points.shape) if loop else points
    assert torch.equal(small.nearest(points), expected)


def test_derivative(small: Polytope, generator: torch.Generator) -> None:
    points = 2 * torch.randn(20, 3, generator=generator, dtype=torch.float64)
    assert torch.autograd.gradcheck(small.nearest, points.requires_grad_())
    assert torch.autograd.gradgradcheck(small.nearest, points)


def test_points_without_a_place(small: Polytope) -> None:
    nan, inf = float("nan"), float("inf")
    assert bool(small.nearest(torch.tensor((nan, 0.0, 0.0)).double()).isnan().all())
    far = small.nearest(torch.tensor((inf, -inf, 0.5)).double())
    assert bool(far.isfinite().all())
    assert float(small.excess(far).max()) < 1e-9


def test_touching_rows_count_once() -> None:
    """A row that only touches the box adds no face; the nearest point is the box's."""
    one = torch.ones(1, 2).double()
    square = polytope(torch.zeros(2).double(), torch.ones(2).double(), one, torch.tensor((2.0,)).double())
    assert len(square.flatten) == 9
    torch.testing.assert_close(square.nearest(torch.tensor((3.0, 2.0)).double()), torch.ones(2).double())


def test_contradictions() -> None:
    with pytest.raises(ValueError, match="some point satisfies"):
        polytope(LOWER, UPPER, torch.tensor(((1.0, 0.0, 0.0),)).double(), torch.tensor((-2.0,)).double())
