"""The prior over poses and shapes: feasible samples that follow the density, walls, energies, seeds."""

import math
from functools import lru_cache

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.hand.kinematics import DOFS, posture
from torchhand.hand.primitives import PenetrationSettings, penetration, place_primitives, primitive_sizes
from torchhand.hand.prior.postures import COMPONENTS
from torchhand.hand.prior.prior import HandPrior, HandPriorSettings

FIST = tuple(component for component in COMPONENTS if component.name == "fist")


@lru_cache(maxsize=4)
def _prior(settings: HandPriorSettings | None = None, dtype: torch.dtype = torch.float64) -> HandPrior:
    model = load_hand_model()
    return HandPrior(model.skeleton, model.shape_space, settings, dtype=torch.float64).to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_every_sample_is_feasible(dtype: torch.dtype, generator: torch.Generator) -> None:
    prior = _prior(None, dtype)
    poses, shapes = prior.sample(20_000 if dtype == torch.float32 else 500, generator)
    assert poses.dtype == shapes.dtype == dtype
    assert bool((poses[:, :6] == 0).all())
    assert float(prior.constraints.violation(poses).worst.max()) < 1e-6
    assert float(prior.population.violation(shapes).worst.max()) < 1e-6
    few = slice(0, 1000)
    sizes = primitive_sizes(prior.kinematics.shape_space, shapes[few])
    deepest = penetration(place_primitives(prior.kinematics(poses[few], shapes[few]), sizes)).worst
    assert float(deepest.max()) <= prior.settings.deepest
    assert bool(prior.log_prob(poses[few], shapes[few]).isfinite().all())


def test_seeds() -> None:
    draws = [_prior().sample(50, torch.Generator().manual_seed(seed)) for seed in (5, 5, 6)]
    assert torch.equal(draws[0][0], draws[1][0])
    assert torch.equal(draws[0][1], draws[1][1])
    assert not torch.equal(draws[0][0], draws[2][0])
    poses, shapes = _prior().sample(0, torch.Generator())
    assert poses.shape == (0, 36)
    assert shapes.shape == (0, 52)


def test_samples_follow_the_penetration(generator: torch.Generator) -> None:
    """Rejection against weighting: means over samples are those over unchecked fists weighted with exp(−penalty)."""
    settings = HandPriorSettings(components=FIST)
    prior = _prior(settings)
    free = _prior(HandPriorSettings(components=FIST, penetration=None))
    poses, shapes = free.sample(3000, generator)
    change = prior.log_prob(poses, shapes) - free.log_prob(poses, shapes)
    weight = change.exp() / change.exp().sum()
    drawn, population = prior.sample(3000, generator)
    found = prior.log_prob(drawn, population) - free.log_prob(drawn, population)
    expected = float((weight * change.clamp_min(-20)).sum())  # where the weight is zero the cost does not matter
    spread = float(((weight * (change.clamp_min(-20) - expected)) ** 2).sum().sqrt() + found.std() / math.sqrt(3000))
    assert float(found.mean()) == pytest.approx(expected, abs=3 * spread)
    assert float(change.clamp_min(-20).mean()) < expected - 10 * spread  # it does matter
    angle = DOFS.index("middle_mcp_fe")
    assert float(drawn[:, angle].mean()) == pytest.approx(float((weight * poses[:, angle]).sum()), abs=0.01)


def test_energy_is_minus_log_prob_inside_and_finite_outside(generator: torch.Generator) -> None:
    prior = _prior()
    poses, shapes = prior.sample(100, generator)
    torch.testing.assert_close(prior.energy(poses, shapes), -prior.log_prob(poses, shapes), rtol=0, atol=1e-9)
    torch.testing.assert_close(prior.energy(poses), -prior.log_prob(poses), rtol=0, atol=1e-9)
    wild = (10 * (2 * torch.rand(200, 36, generator=generator, dtype=torch.float64) - 1)).requires_grad_()
    odd = (shapes[:1] * (1 + 0.5 * torch.randn(200, 52, generator=generator, dtype=torch.float64))).requires_grad_()
    energy = prior.energy(wild, odd)
    assert bool(energy.isfinite().all())
    assert all(bool(x.isfinite().all()) for x in torch.autograd.grad(energy.sum(), (wild, odd)))
    assert bool((prior.log_prob(wild, odd) == -math.inf).all())


def test_energy_leads_back(generator: torch.Generator) -> None:
    """Plain descent from wild poses ends at likely ones, within the limits to a degree."""
    prior = _prior()
    pose = posture("flat", dtype=torch.float64) + 0.5 * torch.randn(16, 36, generator=generator, dtype=torch.float64)
    pose.requires_grad_()
    before = prior.energy(pose).detach()
    optimiser = torch.optim.Adam([pose], lr=0.03)
    for _ in range(150):
        optimiser.zero_grad()
        prior.energy(pose).sum().backward()
        optimiser.step()
    after = prior.energy(pose).detach()
    assert bool((after < before - 50).all())
    assert float(prior.constraints.violation(pose.detach()).worst.max()) < math.radians(1.0)


def test_derivatives(generator: torch.Generator) -> None:
    model = load_hand_model()
    prior = HandPrior(model.skeleton, model.shape_space, HandPriorSettings(components=FIST), dtype=torch.float64)
    poses, shapes = prior.sample(1, generator)
    pose, shape = poses[0].requires_grad_(), shapes[0].requires_grad_()
    assert torch.autograd.gradcheck(prior.log_prob, (pose, shape), atol=1e-3, rtol=1e-3)
    assert torch.autograd.gradcheck(prior.energy, (pose, shape), atol=1e-3, rtol=1e-3)


@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")
def test_derivatives_of_one_hand_in_both_modes(generator: torch.Generator) -> None:
    """In float32, as a pipeline has it: forwards and backwards they are the same, in the prior's own dtype."""
    prior = _prior(dtype=torch.float32)
    poses, shapes = prior.sample(2, generator)
    forward, reverse = (
        torch.vmap(mode(prior.energy, argnums=(0, 1)))(poses, shapes) for mode in (torch.func.jacfwd, torch.func.jacrev)
    )
    for one, other in zip(forward, reverse, strict=True):
        torch.testing.assert_close(one, other, atol=1e-4 * float(other.abs().max()), rtol=1e-4)
    over = torch.func.hessian(prior.energy)(poses[0])
    twice = torch.autograd.functional.hessian(prior.energy, poses[0])
    torch.testing.assert_close(over, twice, atol=1e-4 * float(over.abs().max()), rtol=1e-4)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches(generator: torch.Generator, batch: tuple[int, ...]) -> None:
    prior = _prior()
    poses, shapes = prior.sample(max(1, math.prod(batch)), generator)
    together = prior.log_prob(poses.reshape(*batch, 36), shapes.reshape(*batch, 52))
    assert together.shape == batch
    loop = torch.stack([prior.log_prob(pose, shape) for pose, shape in zip(poses, shapes, strict=True)])
    torch.testing.assert_close(together.flatten(), loop, atol=1e-9, rtol=0)
    common = prior.energy(poses.reshape(*batch, 36), shapes[0])
    assert common.shape == batch


def test_what_is_unlikely() -> None:
    """A finger through its neighbour, a giant's hand and NaN have no probability; a relaxed hand has much."""
    prior = _prior()
    crossed = posture("flat", dtype=torch.float64)
    crossed[DOFS.index("index_mcp_aa")] = -0.34
    assert bool(prior.constraints.is_feasible(crossed))
    assert float(prior.log_prob(crossed)) == -math.inf
    shape = prior.kinematics.default_shape.clone()
    assert float(prior.log_prob(posture("flat", dtype=torch.float64), shape)) > 0
    assert (
        float(prior.log_prob(posture("flat", dtype=torch.float64)))
        > float(prior.log_prob(posture("victory", dtype=torch.float64)))
        == -math.inf
    )
    shape[0] = 0.3
    assert float(prior.log_prob(posture("flat", dtype=torch.float64), shape)) == -math.inf
    assert math.isfinite(float(prior.energy(posture("flat", dtype=torch.float64), shape)))
    broken = posture("flat", dtype=torch.float64)
    broken[DOFS.index("index_pip_fe")] = math.nan
    assert float(prior.log_prob(broken)) == -math.inf
    assert math.isnan(float(prior.energy(broken)))


def test_what_it_refuses(generator: torch.Generator) -> None:
    with pytest.raises(ValueError, match=r"deepest: expected above 0, got 0\.0"):
        HandPriorSettings(deepest=0.0)
    with pytest.raises(ValueError, match="count: expected 0 or more, got -1"):
        _prior().sample(-1, generator)
    impossible = HandPriorSettings(
        components=FIST, penetration=PenetrationSettings(slack=0.0, neighbour_slack=0.0, softness=1e-5)
    )
    model = load_hand_model()
    prior = HandPrior(model.skeleton, model.shape_space, impossible, dtype=torch.float64)
    with pytest.raises(ValueError, match=r"sample: expected postures that hardly penetrate themselves, found \d+ in"):
        prior.sample(500, generator)


def test_poses_and_shapes_of_other_sizes_are_refused() -> None:
    """Also where nothing checks annotations: the functions under the tests' own checks."""
    model = load_hand_model()
    prior, pose, shape = (
        model.prior(dtype=torch.float64),
        posture("open", dtype=torch.float64),
        model.shape_space.default,
    )
    for density in (HandPrior.log_prob.__wrapped__.__wrapped__, HandPrior.energy.__wrapped__.__wrapped__):  # pyright: ignore
        with pytest.raises(ValueError, match=r"pose: expected 36 numbers in the last dimension, got shape \(35,\)"):
            density(prior, pose[:35])
        with pytest.raises(ValueError, match=r"shape: expected 52 numbers in the last dimension, got shape \(51,\)"):
            density(prior, pose, shape[:51])
        with pytest.raises(ValueError, match=r"pose: expected torch.float64, in which the prior computes, got torch.f"):
            density(prior, pose.float())
