"""Priors as factors: derivatives, a Gaussian about any reference, the closed form of a linear problem."""

import math
from dataclasses import dataclass

import pytest
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit.observation import Equations, Explained, Observation, PosedHands
from torchhand.fit.posture import PostureResiduals
from torchhand.fit.priors import ConstraintPrior, GaussianPrior, PosturePrior
from torchhand.fit.problem import Problem
from torchhand.fit.schedule import Stage
from torchhand.fit.solve import solve
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandPose, PoseConstraints, PoseSpace, named_pose_space
from torchhand.hand.limits import clamp_to_limits

MODEL = load_hand_model()
SPACE = named_pose_space("dof26")
STAGE = Stage(gross_m=0.01, rounds=1, iterations=30)


def normal(generator: torch.Generator, *size: int) -> Tensor:
    return torch.randn(*size, generator=generator, dtype=torch.float64)


def hands(generator: torch.Generator, count: int, spread: float = 0.3) -> HandPose:
    dofs = spread * normal(generator, count, 36)
    dofs = clamp_to_limits(dofs, MODEL.skeleton)
    return HandPose(dofs=dofs, reference=rotation_from_vector(normal(generator, count, 3)))


def posed(pose: HandPose) -> PosedHands:
    return PosedHands(pose=pose, shape=MODEL.shape_space.default.double())


def covariance(generator: torch.Generator, *batch: int) -> Tensor:
    root = 0.1 * normal(generator, *batch, SPACE.size, SPACE.size)
    return root @ root.mT + 0.01 * torch.eye(SPACE.size, dtype=torch.float64)


@pytest.fixture(scope="module")
def postures() -> PostureResiduals:
    return PostureResiduals.of(MODEL.prior().postures)


def prior_of(kind: str, postures: PostureResiduals, generator: torch.Generator) -> Observation:
    if kind.startswith("constraints"):
        return ConstraintPrior(
            constraints=PoseConstraints(MODEL.skeleton), weight=0.7, has_ties=kind == "constraints with ties"
        )
    if kind.startswith("posture"):
        return PosturePrior(postures=postures, weight=1.3, tail=3.0 if kind == "posture with a tail" else math.inf)
    return GaussianPrior.of_covariance(hands(generator, 3), covariance(generator, 3), SPACE)


@pytest.mark.parametrize("kind", ["constraints", "constraints with ties", "posture", "posture with a tail", "gaussian"])
def test_the_equations_are_the_derivatives_of_the_cost(
    kind: str, postures: PostureResiduals, generator: torch.Generator
) -> None:
    """First by central differences of the cost; second, but for what the rows of violated walls bend, of the first."""
    prior, here = prior_of(kind, postures, generator), hands(generator, 3)
    if kind.startswith("constraints"):  # off the limits, where walls begin
        here = HandPose(dofs=here.dofs + 0.05 * normal(generator, 3, 36), reference=here.reference)
    factor = prior.associate(posed(here), STAGE)
    found, step = factor.equations(posed(here)), 1e-6
    first = found.first_dof
    gradient, slopes = torch.zeros(3, 36).double(), []
    gradient[:, first:] = found.gradient
    for dof, direction in enumerate(torch.eye(36, dtype=torch.float64)):
        ends = [
            factor.equations(posed(HandPose(dofs=here.dofs + sign * step * direction, reference=here.reference)))
            for sign in (1, -1)
        ]
        slope = (ends[0].cost - ends[1].cost) / (2 * step)
        scale = gradient.abs().amax(-1)
        assert bool(((gradient[:, dof] - slope).abs() <= 1e-6 * scale + 1e-6).all()), DOFS[dof]
        slopes.append((ends[0].gradient - ends[1].gradient) / (2 * step))
    if not kind.startswith("constraints"):
        second = torch.stack(slopes[first:], -1)
        torch.testing.assert_close(found.matrix, second, atol=1e-4 * float(second.abs().max()), rtol=0)
    lowest = torch.linalg.eigvalsh(found.matrix).amin(-1)
    assert bool((lowest >= -1e-9 * found.matrix.abs().amax((-2, -1))).all())


def test_ties_are_left_to_the_posture_prior_where_it_has_them(generator: torch.Generator) -> None:
    here, constraints = posed(hands(generator, 4)), PoseConstraints(MODEL.skeleton)
    costs = [
        ConstraintPrior(constraints=constraints, has_ties=has_ties).associate(here, STAGE).equations(here).cost
        for has_ties in (False, True)
    ]
    assert bool((costs[0] < costs[1]).all())


def test_an_unusual_posture_is_pulled_less_where_the_tail_is_long(
    postures: PostureResiduals, generator: torch.Generator
) -> None:
    usual = HandPose.of(MODEL.prior().postures.sample(200, generator)[0].double())
    unusual = HandPose.of(clamp_to_limits(usual.dofs + 0.6, MODEL.skeleton))

    def pull(one: HandPose, tail: float) -> float:
        found = PosturePrior(postures=postures, tail=tail).associate(posed(one), STAGE).equations(posed(one))
        return float(found.gradient.norm(dim=-1).median())

    assert pull(usual, 3.0) == pytest.approx(pull(usual, math.inf), rel=0.5)
    assert pull(unusual, 3.0) < 0.2 * pull(unusual, math.inf)


def test_normalised_costs_of_two_components_differ_as_their_densities_do(
    postures: PostureResiduals, generator: torch.Generator
) -> None:
    """The component of each hand is its likeliest; costs are never below 0."""
    some = HandPose.of(MODEL.prior().postures.sample(60, generator)[0].double())
    prior = PosturePrior(postures=postures, is_normalized=True)
    cost = prior.associate(posed(some), STAGE).equations(posed(some)).cost
    missed = (some.dofs[:, None, None, 6:] @ postures.matrix.mT).squeeze(-2) - postures.offset
    density = (-0.5 * missed.square().sum(-1) - postures.level).amax(-1)
    torch.testing.assert_close(cost - cost[0], density[0] - density, atol=1e-9, rtol=0)
    assert len(set(postures.likeliest(some.dofs).tolist())) > 3
    assert float(cost.min()) >= 0


# ------------------------------------------------------------------ the Gaussian


def test_a_gaussian_costs_half_the_squared_mahalanobis_distance(generator: torch.Generator) -> None:
    """Of the step from the expected hands, whatever the references of both."""
    expected, spread = hands(generator, 5), covariance(generator)
    step = torch.zeros(5, 36, dtype=torch.float64)
    named = [DOFS.index(name) for name in SPACE.free_names]
    step[:, named] = 0.1 * normal(generator, 5, SPACE.size)
    there = expected.retract(step)
    prior = GaussianPrior.of_covariance(expected, spread, SPACE)
    cost = (
        prior.associate(posed(there.about(expected.rotation)), STAGE)
        .equations(posed(there.about(expected.rotation)))
        .cost
    )
    deviation = step[:, named] / SPACE.basis[named].diagonal()
    torch.testing.assert_close(cost, 0.5 * (deviation @ torch.linalg.inv(spread) * deviation).sum(-1))
    at_home = posed(expected)
    assert float(prior.associate(at_home, STAGE).equations(at_home).cost.abs().max()) < 1e-20


@pytest.mark.parametrize("count", [1, 4])
def test_the_expected_hand_is_the_same_about_another_reference(count: int, generator: torch.Generator) -> None:
    """The cost has its minimum, zero, at the expected hand, wherever rotation vectors are counted from."""
    expected = hands(generator, count)
    prior = GaussianPrior.of_covariance(expected, covariance(generator, count), SPACE)
    nearby = rotation_from_vector(0.3 * normal(generator, count, 3)) @ expected.rotation
    about = posed(expected.about(nearby))
    found = prior.associate(about, STAGE).equations(about)
    assert float(found.cost.abs().max()) < 1e-20
    assert float(found.gradient.abs().max()) < 1e-8
    again = GaussianPrior.of_covariance(expected.about(nearby), covariance(generator, count), SPACE)
    assert float(again.associate(posed(expected), STAGE).equations(posed(expected)).cost.abs().max()) < 1e-20


def test_nothing_is_expected_with_an_infinite_deviation(generator: torch.Generator) -> None:
    std = torch.full((SPACE.size,), torch.inf, dtype=torch.float64)
    here = posed(hands(generator, 2))
    found = GaussianPrior.of_std(hands(generator, 1)[0], std, SPACE).associate(here, STAGE).equations(here)
    assert not bool(found.cost.any())
    assert not bool(found.gradient.any())


def test_rows_are_those_of_the_hypotheses(generator: torch.Generator) -> None:
    expected, here, some = hands(generator, 4), hands(generator, 4), torch.tensor([3, 1])
    for information in (covariance(generator), covariance(generator, 4)):
        prior = GaussianPrior.of_covariance(expected, information, SPACE)
        whole = prior.associate(posed(here), STAGE)
        chosen = prior.rows(some).associate(posed(here[some]), STAGE)
        for part in (chosen, whole.rows(some)):
            cost = part.equations(posed(here[some])).cost
            torch.testing.assert_close(cost, whole.equations(posed(here)).cost[some], atol=0, rtol=1e-12)
    shared = GaussianPrior.of_covariance(expected[0], covariance(generator), SPACE)
    assert shared.rows(some) is shared


@dataclass(frozen=True, kw_only=True)
class Linear:
    """Measurements matrix · dofs = value with unit variance; the same for all."""

    matrix: Float[Tensor, "m 36"]
    value: Float[Tensor, "m"]
    is_empty: bool = False

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "Linear":
        return self

    def associate(self, hands: PosedHands, stage: Stage) -> "Linear":
        return self

    def equations(self, hands: PosedHands) -> Equations:
        residual = hands.pose.dofs @ self.matrix.T - self.value
        rows = self.matrix.expand(len(hands), *self.matrix.shape)
        return Equations.of_rows(residual, torch.ones_like(residual), rows, 0.5 * residual.square().sum(-1))

    def explained(self) -> tuple[Explained, ...]:
        return ()


@pytest.mark.parametrize("name", ["dof26", "planar_abduction", "dof36"])
def test_a_linear_problem_has_the_closed_form_of_a_kalman_update(name: str, generator: torch.Generator) -> None:
    """Mean and covariance of solve against gain and innovation, in spaces with and without tied angles; no limit is
    reached, and no rotation measured, about which nothing is linear."""
    space: PoseSpace = named_pose_space(name)
    expected, size = HandPose.of(torch.zeros(36, dtype=torch.float64)), space.size
    root = 0.004 * normal(generator, size, size)
    spread = root @ root.mT + 1e-5 * torch.eye(size, dtype=torch.float64)
    middle = 0.5 * (MODEL.skeleton.lower + MODEL.skeleton.upper)
    start = space.free(torch.cat((torch.zeros(6).double(), middle)))
    rotations = [i for i, free in enumerate(space.free_names) if free.startswith("root_r")]
    start[rotations] = 0.0
    expected = HandPose.of(space.dof(start))
    matrix = 100 * normal(generator, 7, 36)
    matrix[:, 3:6] = 0
    value = expected.dofs @ matrix.T + normal(generator, 7)
    problem = Problem(
        space=space,
        skeleton=MODEL.skeleton,
        shape=MODEL.shape_space.default.double(),
        observations=(Linear(matrix=matrix, value=value),),
        priors=(GaussianPrior.of_covariance(expected, spread, space),),
    )
    found = solve(problem, expected, (Stage(gross_m=1.0, rounds=60, method="gauss_newton"),))
    inner = matrix @ space.basis
    gain = spread @ inner.T @ torch.linalg.inv(inner @ spread @ inner.T + torch.eye(7, dtype=torch.float64))
    mean = start + gain @ (value - expected.dofs @ matrix.T)
    posterior = spread - gain @ inner @ spread
    moved = expected.step_to(found.pose)
    torch.testing.assert_close(moved, space.dof(mean) - expected.dofs, atol=1e-8, rtol=0)
    torch.testing.assert_close(found.covariance, posterior, atol=1e-6 * float(posterior.abs().max()), rtol=0)
