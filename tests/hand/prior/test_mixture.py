"""The mixture of postures: a density that is normalised and that its samples follow, on the feasible set only."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import truncnorm
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.hand.kinematics import DOFS, JOINT_DOFS, posture
from torchhand.hand.limits import TIES, ConstraintSettings, PoseConstraints
from torchhand.hand.prior.components import DigitAngles, PostureComponent, posture_component
from torchhand.hand.prior.mixture import PostureMixture
from torchhand.hand.prior.postures import COMPONENTS


def _mixture(components: tuple[PostureComponent, ...] = COMPONENTS, **settings: object) -> PostureMixture:
    constraints = PoseConstraints(load_hand_model().skeleton, ConstraintSettings(**settings))  # pyright: ignore
    return PostureMixture(constraints, components)


def _component(name: str) -> PostureComponent:
    return next(component for component in COMPONENTS if component.name == name)


@pytest.mark.parametrize("bands", ["paper", "neighbours", "none"])
@pytest.mark.parametrize("ties", ["soft", "hard"])
def test_every_sample_is_feasible(bands: str, ties: str, generator: torch.Generator) -> None:
    mixture = _mixture(bands=bands, ties=ties)
    poses, _ = mixture.sample(5000, generator)
    assert float(mixture.constraints.violation(poses).worst.max()) < 1e-12
    assert bool(mixture.log_prob(poses).isfinite().all())
    assert bool((poses[:, :6] == 0).all())
    single, _ = mixture.float().sample(5000, generator)
    assert single.dtype == torch.float32
    assert float(mixture.constraints.violation(single).worst.max()) < 1e-6
    assert bool(mixture.log_prob(single).isfinite().all())


@pytest.mark.parametrize(("name", "bands"), [("relaxed", "paper"), ("victory", "paper"), ("half_closed", "neighbours")])
def test_samples_follow_the_normalised_density(name: str, bands: str, generator: torch.Generator) -> None:
    """Against an independent density q (scipy's truncated normals): the mean of q / p over samples of p is the share of
    q that is feasible. Only then is p the samples' density, and integrates to one."""
    mixture = _mixture((_component(name),), bands=bands)
    poses, _ = mixture.sample(80_000, generator)
    skeleton = mixture.constraints.skeleton
    mean, std = poses[:, 6:].mean(0).numpy(), 0.8 * mixture.std[0].numpy()
    low, high = skeleton.lower.numpy(), skeleton.upper.numpy()
    reference = truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std)
    log_q = reference.logpdf(poses[:, 6:].numpy()).sum(-1)  # pyright: ignore
    weight = np.exp(log_q - mixture.log_prob(poses).numpy())
    drawn = torch.from_numpy(reference.rvs(size=(4000, 30), random_state=np.random.default_rng(0)))
    feasible = mixture.constraints.is_feasible(torch.cat((torch.zeros(4000, 6, dtype=torch.float64), drawn), -1))
    error = weight.std() / math.sqrt(len(weight))
    assert error < 0.03
    assert weight.mean() == pytest.approx(float(feasible.double().mean()), abs=4 * error + 0.01)


def test_mixture_is_the_sum_of_its_postures(generator: torch.Generator) -> None:
    two = (replace(_component("relaxed"), weight=1.0), replace(_component("open"), weight=3.0))
    mixture = _mixture(two)
    poses, kind = mixture.sample(4000, generator)
    one, other = (_mixture((component,)).log_prob(poses).exp() for component in two)
    torch.testing.assert_close(mixture.log_prob(poses).exp(), 0.25 * one + 0.75 * other, rtol=1e-9, atol=0)
    assert float(kind.double().mean()) == pytest.approx(0.75, abs=0.03)
    assert mixture.names == ("relaxed", "open")


def test_postures_are_likelier_than_what_is_merely_possible(generator: torch.Generator) -> None:
    mixture = _mixture()
    skeleton = mixture.constraints.skeleton
    fraction = torch.rand(500, 30, generator=generator, dtype=torch.float64)
    joints = skeleton.lower + fraction * (skeleton.upper - skeleton.lower)
    possible = mixture.constraints.project(torch.cat((torch.zeros(500, 6, dtype=torch.float64), joints), -1))
    usual = float(mixture.log_prob(possible).median())
    for name in ("open", "flat", "fist", "point", "three", "four", "l", "shaka"):
        assert float(mixture.log_prob(posture(name, dtype=torch.float64))) > usual + 50, name


def test_couplings_of_the_samples(generator: torch.Generator) -> None:
    """Neighbouring fingers bend together, end joints bend two thirds of the middle ones, bent fingers do not spread."""
    poses, _ = _mixture().sample(20_000, generator)
    angle = {dof: poses[:, DOFS.index(dof)] for dof in JOINT_DOFS}
    for one, other in (("index", "middle"), ("middle", "ring"), ("ring", "little")):
        pair = torch.stack((angle[f"{one}_mcp_fe"], angle[f"{other}_mcp_fe"]))
        assert float(torch.corrcoef(pair)[0, 1]) > 0.6
    bent = angle["middle_pip_fe"] > 0.5
    ratio = (angle["middle_dip_fe"] / angle["middle_pip_fe"])[bent]
    assert float(ratio.median()) == pytest.approx(2 / 3, abs=0.05)
    closed = angle["little_mcp_fe"] > math.radians(70)
    assert float(angle["little_mcp_aa"][closed].std()) < 0.6 * float(angle["little_mcp_aa"][~closed].std())


def test_hard_ties_hold_in_samples(generator: torch.Generator) -> None:
    mixture = _mixture(ties="hard")
    poses, _ = mixture.sample(500, generator)
    assert float(mixture.constraints.tie_residuals(poses).abs().max()) < 1e-12
    poses[:, DOFS.index("index_dip_fe")] += 1e-3
    assert bool((mixture.log_prob(poses) == -math.inf).all())
    assert {tie.equation for tie in TIES} == {1, 4, 5}


def test_walls_and_slopes(generator: torch.Generator) -> None:
    """Minus infinity outside; the smooth formula equal inside, finite and with a finite slope everywhere."""
    mixture = _mixture()
    inside, _ = mixture.sample(200, generator)
    torch.testing.assert_close(mixture.log_density(inside), mixture.log_prob(inside), rtol=0, atol=0)
    outside = inside.clone()
    outside[:, DOFS.index("index_pip_fe")] = 2.0
    assert bool((mixture.log_prob(outside) == -math.inf).all())
    for dtype in (torch.float32, torch.float64):
        wild = (
            (10 * (2 * torch.rand(2000, 36, generator=generator, dtype=torch.float64) - 1)).to(dtype).requires_grad_()
        )
        density = mixture.to(dtype).log_density(wild)
        (slope,) = torch.autograd.grad(density.sum(), wild)
        assert bool(density.isfinite().all() & slope.isfinite().all())


def test_derivatives(generator: torch.Generator) -> None:
    mixture = _mixture(COMPONENTS[:4])
    inside, _ = mixture.sample(2, generator)
    poses = torch.cat((inside, 3 * torch.randn(1, 36, generator=generator, dtype=torch.float64))).requires_grad_()
    assert torch.autograd.gradcheck(mixture.log_density, poses, atol=1e-4)


def test_root_has_no_part() -> None:
    mixture = _mixture()
    pose = posture("flat", dtype=torch.float64)
    moved = pose.clone()
    moved[:6] = torch.arange(6.0)
    assert float(mixture.log_prob(moved)) == float(mixture.log_prob(pose))


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches(generator: torch.Generator, batch: tuple[int, ...]) -> None:
    mixture = _mixture()
    flat, _ = mixture.sample(max(1, math.prod(batch)), generator)
    together = mixture.log_prob(flat.reshape(*batch, 36))
    assert together.shape == batch
    loop = torch.stack([mixture.log_prob(pose) for pose in flat])
    torch.testing.assert_close(together.flatten(), loop, atol=1e-10, rtol=0)


def test_single_precision_is_close(generator: torch.Generator) -> None:
    mixture = _mixture()
    poses, _ = mixture.sample(500, generator)
    expected = mixture.log_density(poses)
    torch.testing.assert_close(mixture.float().log_density(poses.float()).double(), expected, atol=5e-3, rtol=1e-4)


def test_works_under_vmap(generator: torch.Generator) -> None:
    mixture = _mixture(COMPONENTS[:3])
    poses, _ = mixture.sample(5, generator)
    slopes = torch.func.vmap(torch.func.grad(mixture.log_density))(poses)
    leaf = poses.clone().requires_grad_()
    (expected,) = torch.autograd.grad(mixture.log_density(leaf).sum(), leaf)
    torch.testing.assert_close(slopes, expected, atol=1e-10, rtol=1e-10)


def test_what_it_refuses() -> None:
    with pytest.raises(ValueError, match="expected at least one posture"):
        _mixture(())
    with pytest.raises(ValueError, match=r"abduction_vanishes_at_deg: expected beyond .* got 70\.0"):
        _mixture(abduction_vanishes_at_deg=70.0)
    with pytest.raises(ValueError, match=r"weight of open: expected above 0 and finite, got 0\.0"):
        replace(_component("open"), weight=0.0)
    with pytest.raises(ValueError, match="angles of open: expected finite means"):
        replace(_component("open"), std=torch.zeros(30, dtype=torch.float64))


def test_components_are_postures_a_hand_can_take() -> None:
    """The expected angles themselves, not only their neighbourhood, are feasible to a few degrees."""
    constraints = PoseConstraints(load_hand_model().skeleton)
    for component in COMPONENTS:
        pose = torch.cat((torch.zeros(6, dtype=torch.float64), component.mean))
        worst: Tensor = constraints.violation(pose).worst
        assert float(worst) < math.radians(3), f"{component.name}: {constraints.violation(pose).describe()}"
    assert len({component.name for component in COMPONENTS}) == len(COMPONENTS)
    flat = posture_component(
        "mine",
        1.0,
        DigitAngles(thumb=(0, 0, 0, 0, 0, 0), index=(0, 0, 30), middle=(0, 0, 0), ring=(0, 0, 0), little=(0, 0, 0)),
    )
    assert float(flat.mean[JOINT_DOFS.index("index_dip_fe")]) == pytest.approx(math.radians(20))
