"""The 21 anthropometric constraints: published numbers, the projection's laws, the distribution over people."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.hand.kinematics import ShapeSpace
from torchhand.hand.limits.anthropometry import MEASURES, Anthropometry, AnthropometrySettings


def _space() -> ShapeSpace:
    return load_hand_model().shape_space


def _wild(count: int, generator: torch.Generator, dtype: torch.dtype = torch.float64) -> Tensor:
    space = _space()
    scale = 10 ** (2 * torch.rand(count, 1, generator=generator, dtype=torch.float64) - 1)
    noise = torch.randn(count, len(space.names), generator=generator, dtype=torch.float64)
    return (space.default + scale * space.std * noise).to(dtype)


def test_there_are_21_and_the_default_has_the_published_means() -> None:
    population = Anthropometry(_space())
    assert len(MEASURES) == len(set(MEASURES)) == 21
    measures = dict(zip(MEASURES, population.measures(_space().default).tolist(), strict=True))
    published = {"thumb_length": 0.354, "index_length": 0.485, "middle_length": 0.544, "little_length": 0.414}
    published |= {"middle_proximal": 0.266, "thumb_distal": 0.158, "palm_length": 0.602}
    for name, fraction in published.items():
        assert measures[name] == pytest.approx(fraction, abs=1e-9), name
    assert measures["palm_breadth"] == pytest.approx(0.4445, abs=1e-3)
    assert population.violation(_space().default).describe() == "none"


def test_intervals() -> None:
    population = Anthropometry(_space())
    index = MEASURES.index
    assert float(population.upper[index("middle_proximal")]) == pytest.approx(0.266 * 1.10)
    assert float(population.lower[index("middle_distal")]) == pytest.approx(0.108 * 0.84)
    assert float(population.lower[index("palm_length")]) == pytest.approx(0.562)
    assert float(population.upper[index("palm_breadth")]) == pytest.approx(0.4933)
    assert bool((population.lower >= 0).all())


def test_violations_are_named() -> None:
    space = _space()
    shape = space.default.clone()
    shape[space.names.index("index_proximal")] = 0.29
    violation = Anthropometry(space).violation(shape)
    assert violation.describe() == "interval of index_proximal by 0.0205"
    shape[space.names.index("palm_cap")] = 0.5
    assert Anthropometry(space).violation(shape).describe().startswith("bounds of palm_cap by 0.3400")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_projection_is_feasible_and_idempotent(generator: torch.Generator, dtype: torch.dtype) -> None:
    population = Anthropometry(_space())
    near = population.project(_wild(5000, generator, dtype))
    assert float(population.violation(near).worst.max()) < (2e-7 if dtype == torch.float32 else 1e-12)
    torch.testing.assert_close(population.project(near), near, atol=1e-12, rtol=0)
    inside = population.sample(500, generator, dtype=torch.float64)
    assert torch.equal(population.project(inside), inside)


def test_projection_is_the_nearest(generator: torch.Generator) -> None:
    """No feasible shape on the way to random people is nearer, in spreads; steps to the side lead away."""
    space, population = _space(), Anthropometry(_space())
    wild = _wild(300, generator)
    near = population.project(wild)
    for target in population.sample(20, generator, dtype=torch.float64):
        towards = (target - near) / space.std
        back = (wild - near) / space.std
        assert float((towards * back).sum(-1).max()) < 1e-8  # the variational inequality of a projection


def test_penalty_and_its_derivatives(generator: torch.Generator) -> None:
    space, population = _space(), Anthropometry(_space())
    assert float(population.penalty(population.sample(200, generator, dtype=torch.float64)).max()) == 0
    assert float(population.penalty(population.project(_wild(200, generator))).max()) < 1e-20
    shape = space.default.clone()
    place = space.names.index("index_proximal")
    shape[place] = 0.2695 + 0.25 * 0.05 * 0.245
    assert float(population.penalty(shape)) == pytest.approx(0.5)
    wild = _wild(2, generator).requires_grad_()
    assert torch.autograd.gradcheck(population.penalty, wild, atol=1e-4)
    assert torch.autograd.gradcheck(population.measures, wild)
    assert torch.autograd.gradcheck(population.project, wild)


def test_density_is_the_multivariate_normals(generator: torch.Generator) -> None:
    space, population = _space(), Anthropometry(_space())
    covariance = torch.diag(space.std**2)
    tall, wide = space.names.index("hand_length"), space.names.index("hand_breadth")
    covariance[tall, wide] = covariance[wide, tall] = 0.715 * space.std[tall] * space.std[wide]
    reference = torch.distributions.MultivariateNormal(space.default, covariance)
    shapes = _wild(50, generator)
    torch.testing.assert_close(population.log_density(shapes), reference.log_prob(shapes), atol=1e-8, rtol=1e-10)
    inside = population.is_feasible(shapes)
    assert 0 < int(inside.sum()) < 50
    assert torch.equal(population.log_prob(shapes).isfinite(), inside)


def test_people(generator: torch.Generator) -> None:
    """Feasible, seeded, of the population's moments, with the published spread of breadth over length."""
    space, population = _space(), Anthropometry(_space(), AnthropometrySettings(reach=4.0))
    drawn = population.sample(20_000, generator, dtype=torch.float64)
    assert bool(population.is_feasible(drawn, tolerance=1e-12).all())
    assert torch.equal(
        population.sample(10, torch.Generator().manual_seed(3), dtype=torch.float64),
        population.sample(10, torch.Generator().manual_seed(3), dtype=torch.float64),
    )
    tall, wide = (drawn[:, space.names.index(name)] for name in ("hand_length", "hand_breadth"))
    assert float(tall.mean()) == pytest.approx(0.187, abs=5e-4)
    assert float(tall.std()) == pytest.approx(0.0115, rel=0.03)
    assert float(torch.corrcoef(torch.stack((tall, wide)))[0, 1]) == pytest.approx(0.715, abs=0.02)
    assert float((wide / tall).std()) == pytest.approx(0.0244, abs=1e-3)
    assert population.sample(0, generator, dtype=torch.float64).shape == (0, 52)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches(generator: torch.Generator, batch: tuple[int, ...]) -> None:
    population = Anthropometry(_space())
    shapes = _wild(max(1, math.prod(batch)), generator).reshape(*batch, 52)
    for function in (
        population.measures,
        population.project,
        population.penalty,
        population.log_density,
        population.is_feasible,
    ):
        loop = torch.stack([function(shape) for shape in shapes.reshape(-1, 52)])
        torch.testing.assert_close(function(shapes), loop.reshape(function(shapes).shape), atol=1e-12, rtol=1e-12)


def test_nan_stays_nan() -> None:
    space, population = _space(), Anthropometry(_space())
    shape = space.default.clone()
    shape[space.names.index("index_middle")] = math.nan
    near = population.project(shape)
    names = {space.names[i] for i in near.isnan().nonzero().flatten().tolist()}
    assert names == {"index_proximal", "index_middle", "index_distal"}
    assert not bool(population.is_feasible(shape))
    assert float(population.log_prob(shape)) == -math.inf


def test_what_it_refuses() -> None:
    with pytest.raises(ValueError, match="reach: expected above 0 and finite, got 0"):
        AnthropometrySettings(reach=0.0)
    with pytest.raises(ValueError, match="length_breadth_correlation: expected between -1 and 1"):
        AnthropometrySettings(length_breadth_correlation=1.0)
    space = _space()
    other = ShapeSpace(
        names=("hand_length", "hand_breadth"),
        units=("m", "m"),
        **{name: getattr(space, name)[:2] for name in ("default", "lower", "upper", "std")},
    )
    with pytest.raises(ValueError, match="shape space: expected a parameter 'thumb_proximal'"):
        Anthropometry(other)
    with pytest.raises(ValueError, match="count: expected 0 or more, got -1"):
        Anthropometry(space).sample(-1, torch.Generator(), dtype=torch.float64)


@pytest.mark.parametrize("name", ["measures", "project", "violation", "penalty", "log_density", "log_prob"])
def test_a_shape_of_another_length_is_refused(name: str) -> None:
    space = load_hand_model().shape_space
    with pytest.raises(ValueError, match=r"shape: expected 52 numbers in the last dimension, got shape \(2, 51\)"):
        getattr(Anthropometry(space), name)(space.default[:51].expand(2, 51))
