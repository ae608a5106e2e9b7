"""From costs in the DOFs to equations in the free parameters: ties, limits, sums, rows."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit.posture import PostureResiduals
from torchhand.fit.priors import ConstraintPrior, GaussianPrior, PosturePrior
from torchhand.fit.problem import Problem
from torchhand.fit.schedule import Stage
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandPose, PoseConstraints, named_pose_space

MODEL = load_hand_model()
STAGE = Stage(gross_m=0.01)
COUNT = 4


def normal(generator: torch.Generator, *size: int) -> Tensor:
    return torch.randn(*size, generator=generator, dtype=torch.float64)


def problem(space: str, generator: torch.Generator) -> Problem:
    """Every factor of it a prior, in float64."""
    own = named_pose_space(space)
    root = normal(generator, COUNT, own.size, own.size)
    expected = HandPose.of(0.2 * normal(generator, COUNT, 36))
    return Problem(
        space=own,
        skeleton=MODEL.skeleton,
        shape=MODEL.shape_space.default.double(),
        observations=(GaussianPrior(pose=expected, information=root @ root.mT, space=own),),
        priors=(
            ConstraintPrior(constraints=PoseConstraints(MODEL.skeleton), has_ties=False),
            PosturePrior(postures=PostureResiduals.of(MODEL.prior().postures)),
        ),
    )


@pytest.mark.parametrize("space", ["dof26", "dof31", "planar_abduction"])
def test_the_gradient_in_the_free_parameters_is_that_of_the_cost(space: str, generator: torch.Generator) -> None:
    """Also where an angle that is tied to another has stopped at its limit and the other goes on."""
    own, rows, step = problem(space, generator), torch.arange(COUNT), 1e-6
    reference = rotation_from_vector(normal(generator, COUNT, 3))
    start = own.values_of(HandPose(dofs=0.3 * normal(generator, COUNT, 36), reference=reference))
    here = own.associated(start, reference, STAGE)
    lower, upper = own.bounds
    finite = lower.isfinite()
    inside = torch.rand(COUNT, len(lower), generator=generator, dtype=torch.float64)
    within = lower.nan_to_num(neginf=0.0) + inside * (upper - lower).nan_to_num(posinf=0.0)
    values = torch.where(finite, within, start)
    dofs, moving = own.dofs_of(values)
    if space == "dof26":
        assert not bool(moving.all())
    assert bool((dofs[:, 6:] >= MODEL.skeleton.lower).all() & (dofs[:, 6:] <= MODEL.skeleton.upper).all())
    gradient = here.equations(values, rows).gradient
    for i, direction in enumerate(torch.eye(own.space.size, dtype=torch.float64)):
        ends = [here.equations(values + sign * step * direction, rows).cost for sign in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step)
        torch.testing.assert_close(gradient[:, i], slope, atol=1e-3, rtol=1e-4, msg=own.space.free_names[i])


def test_costs_of_factors_add_up(generator: torch.Generator) -> None:
    own, reference = problem("dof26", generator), torch.eye(3, dtype=torch.float64).expand(COUNT, 3, 3)
    values = own.values_of(HandPose(dofs=0.2 * normal(generator, COUNT, 36), reference=reference))
    whole = own.associated(values, reference, STAGE).here()
    parts = [
        replace(own, observations=(one,), priors=()).associated(values, reference, STAGE).here()
        for one in (*own.observations, *own.priors)
    ]
    for name in ("cost", "gradient", "matrix"):
        expected = torch.stack([getattr(part, name) for part in parts]).sum(0)
        torch.testing.assert_close(getattr(whole, name), expected, atol=1e-9 * float(expected.abs().max()), rtol=0)


def test_rows_are_those_of_the_hypotheses(generator: torch.Generator) -> None:
    """Of the problem, and of its equations about some hands."""
    own, reference = problem("dof26", generator), rotation_from_vector(normal(generator, COUNT, 3))
    values = own.values_of(HandPose(dofs=0.2 * normal(generator, COUNT, 36), reference=reference))
    some = torch.tensor([3, 1])
    here = own.associated(values, reference, STAGE)
    whole = here.here()
    part = own.rows(some).associated(values[some], reference[some], STAGE).here()
    at_rows = here.equations(values[some], some)
    for found in (part, at_rows):
        torch.testing.assert_close(found.cost, whole.cost[some], atol=0, rtol=1e-12)
        torch.testing.assert_close(found.gradient, whole.gradient[some], atol=1e-9, rtol=1e-9)
    torch.testing.assert_close(here.equations(values, torch.arange(COUNT)).matrix, whole.matrix)


def test_rebased_hands_are_the_same_hands(generator: torch.Generator) -> None:
    own, reference = problem("dof26", generator), rotation_from_vector(normal(generator, COUNT, 3))
    values = own.values_of(HandPose(dofs=0.2 * normal(generator, COUNT, 36), reference=reference))
    values[:, 3:6] = 0.4 * normal(generator, COUNT, 3)
    after, about = own.rebased(values, reference)
    one, other = own.pose_of(values, reference), own.pose_of(after, about)
    assert not bool(other.dofs[:, 3:6].any())
    torch.testing.assert_close(one.rotation, other.rotation)
    kept = [i for i in range(len(DOFS)) if not 3 <= i < 6]
    torch.testing.assert_close(one.dofs[:, kept], other.dofs[:, kept])
