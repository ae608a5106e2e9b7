"""The curve through values that never leaves the span between neighbours."""

import pytest
import torch
from scipy.interpolate import PchipInterpolator

from torchhand.numerics.monotone_cubic import monotone_cubic


def _values(generator: torch.Generator, *batch: int) -> tuple[torch.Tensor, torch.Tensor]:
    knots = torch.rand(9, generator=generator, dtype=torch.float64).cumsum(0) + 0.5
    return knots, torch.randn(*batch, 9, 3, generator=generator, dtype=torch.float64)


def test_it_is_scipys_between_rests(generator: torch.Generator) -> None:
    knots, values = _values(generator)
    values[0], values[-1] = values[1], values[-2]  # a rest at either end, where the end conditions are the same
    at = torch.linspace(float(knots[0]), float(knots[-1]), 200, dtype=torch.float64)
    known = PchipInterpolator(knots.numpy(), values.numpy(), axis=0)(at.numpy())
    assert float((monotone_cubic(knots, values, at) - torch.from_numpy(known)).abs().max()) < 1e-12


def test_it_meets_the_values_and_rests_at_both_ends(generator: torch.Generator) -> None:
    knots, values = _values(generator)
    assert float((monotone_cubic(knots, values, knots) - values).abs().max()) < 1e-14
    step = 1e-5
    for end, inwards in ((0, 1), (-1, -1)):
        near = monotone_cubic(knots, values, knots[end, None] + inwards * step)
        assert float((near - values[end]).abs().max()) < 1e3 * step**2
    outside = torch.tensor([float(knots[0]) - 1, float(knots[-1]) + 1], dtype=torch.float64)
    assert torch.equal(monotone_cubic(knots, values, outside), values[[0, -1]])


def test_it_never_leaves_the_span_of_its_neighbours(generator: torch.Generator) -> None:
    knots, values = _values(generator)
    values[3] = values[4]
    for i in range(8):
        at = torch.linspace(float(knots[i]), float(knots[i + 1]), 50, dtype=torch.float64)
        part = monotone_cubic(knots, values, at)
        low, high = torch.minimum(values[i], values[i + 1]), torch.maximum(values[i], values[i + 1])
        assert bool(((part >= low) & (part <= high)).all())
        rise = part.diff(dim=0) * torch.sign(values[i + 1] - values[i])
        assert float(rise.min()) >= -1e-12


def test_its_slope_is_continuous(generator: torch.Generator) -> None:
    knots, values = _values(generator)
    step = 1e-6
    before, here, after = (monotone_cubic(knots, values, knots[1:-1] + d) for d in (-step, 0.0, step))
    assert float(((after - here) / step - (here - before) / step).abs().max()) < 1e-3


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches(generator: torch.Generator, batch: tuple[int, ...]) -> None:
    knots, values = _values(generator, *batch)
    at = torch.linspace(0, 6, 31, dtype=torch.float64)
    loop = torch.stack([monotone_cubic(knots, one, at) for one in values.reshape(-1, 9, 3)]).reshape(*batch, 31, 3)
    assert torch.equal(monotone_cubic(knots, values, at), loop)


def test_gradients(generator: torch.Generator) -> None:
    knots, values = _values(generator)
    at = torch.tensor([0.7, 1.9, 3.0], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda v: monotone_cubic(knots, v, at), values.requires_grad_())


def test_one_knot_and_wrong_ones() -> None:
    one = torch.ones(1, 2)
    assert torch.equal(monotone_cubic(torch.zeros(1), one, torch.tensor([-1.0, 3.0])), one.expand(2, 2))
    for knots in (torch.zeros(0), torch.tensor([0.0, 0.0]), torch.tensor([1.0, 0.0])):
        with pytest.raises(ValueError, match="knots: expected one or more, increasing"):
            monotone_cubic(knots, torch.zeros(len(knots), 1), torch.zeros(1))
