"""A new kind of observation is one class and its factor: here the ray from a camera on which the index fingertip lies.

It works over many hypotheses with one camera or several, and in the fit of a shape.
"""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.fingertip import TIP, FingertipRay
from torchhand.files import load_hand_model
from torchhand.fit.frames import FrameObservations
from torchhand.fit.observation import Factor, Observation, PosedHands
from torchhand.fit.priors import ConstraintPrior, GaussianPrior
from torchhand.fit.problem import Problem
from torchhand.fit.schedule import Stage
from torchhand.fit.shared import SharedUnknowns
from torchhand.fit.solve import SolveStatus, solve
from torchhand.fit.solve_shared import solve_shared
from torchhand.geometry import rotation_from_vector
from torchhand.hand import (
    Anthropometry,
    HandPose,
    PoseConstraints,
    PoseJacobian,
    named_pose_space,
)
from torchhand.hand.limits import clamp_to_limits

MODEL = load_hand_model()
KINEMATICS = MODEL.kinematics(dtype=torch.float64)
JACOBIAN = PoseJacobian(KINEMATICS)
SPACE = named_pose_space("dof26")
SCHEDULE = (Stage(gross_m=0.01, rounds=4, iterations=10),)
CAMERAS = torch.tensor(((0.0, 0.0, -0.5), (0.5, 0.1, 0.0), (-0.3, 0.4, -0.2), (0.1, -0.5, 0.3)), dtype=torch.float64)


def hands(generator: torch.Generator, count: int, spread: float = 0.15) -> HandPose:
    free = spread * torch.randn(count, SPACE.size, generator=generator, dtype=torch.float64)
    free[:, :3] *= 0.1
    dofs = clamp_to_limits(SPACE.dof(free), MODEL.skeleton)
    turn = 0.2 * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return HandPose(dofs=dofs, reference=rotation_from_vector(turn)).normalized()


def tips(pose: HandPose, shape: Tensor | None = None) -> Tensor:
    return KINEMATICS(pose.dofs, shape, root_reference=pose.reference).keypoints[..., TIP, :]


def rays(tip: Tensor, count: int) -> tuple[FingertipRay, ...]:
    """From the first cameras through a point."""
    directions = torch.nn.functional.normalize(tip - CAMERAS, dim=-1)
    return tuple(
        FingertipRay(origin=CAMERAS[i], direction=directions[i], kinematics=KINEMATICS, jacobian=JACOBIAN, view=i)
        for i in range(count)
    )


def expected(starts: HandPose, std: float = 0.3) -> GaussianPrior:
    deviations = torch.full((SPACE.size,), std, dtype=torch.float64)
    deviations[:3] = 0.1 * std
    return GaussianPrior.of_std(starts, deviations, SPACE)


def problem(observations: tuple[Observation, ...], starts: HandPose) -> Problem:
    return Problem(
        space=SPACE,
        skeleton=MODEL.skeleton,
        shape=KINEMATICS.default_shape,
        observations=observations,
        priors=(ConstraintPrior(constraints=PoseConstraints(MODEL.skeleton)), expected(starts)),
    )


def test_it_has_the_shape_of_an_observation() -> None:
    ray = rays(torch.tensor((0.02, 0.15, 0.05), dtype=torch.float64), 1)[0]
    here = PosedHands(pose=HandPose.of(torch.zeros(1, 36).double()), shape=KINEMATICS.default_shape)
    assert isinstance(ray, Observation)
    assert isinstance(ray.associate(here, SCHEDULE[0]), Factor)


@pytest.mark.parametrize("cameras", [1, 4])
def test_many_hypotheses_with_one_camera_and_with_four(cameras: int, generator: torch.Generator) -> None:
    """Every hypothesis lays its fingertip on the ray, or where the rays meet, and moves no farther than it must."""
    target, starts = tips(hands(generator, 1))[0], hands(generator, 12)
    own = rays(target, cameras)
    found = solve(problem(own, starts), starts, SCHEDULE)
    assert bool((found.status <= SolveStatus.STALLED.value).all())
    difference = tips(found.pose) - target
    for ray in own:
        across = difference - (difference @ ray.direction)[:, None] * ray.direction
        assert float(across.norm(dim=-1).max()) < 2e-4
    if cameras == 4:
        assert float(difference.norm(dim=-1).max()) < 2e-4
    else:
        assert float(difference.norm(dim=-1).median()) > 5e-3  # one camera does not tell how far away
    assert [one.view for one in found.explained] == list(range(cameras))
    assert bool(torch.stack([one.fraction for one in found.explained]).all())
    assert float((tips(starts) - target).norm(dim=-1).median()) > 0.02


def test_a_ray_of_one_camera_leaves_its_own_direction_open(generator: torch.Generator) -> None:
    """The covariance says what was measured."""
    target, starts = tips(hands(generator, 1))[0], hands(generator, 1)
    spread = []
    for cameras in (1, 4):
        own = rays(target, cameras)
        found = solve(problem(own, starts), starts, SCHEDULE)
        frames = KINEMATICS(found.pose.dofs, root_reference=found.pose.reference)
        rows = JACOBIAN(found.pose.dofs, frames)[:, TIP] @ SPACE.basis
        of_tip = (rows @ found.covariance @ rows.mT)[0]
        spread.append(float((own[0].direction @ of_tip @ own[0].direction).sqrt()))
    assert spread[0] > 0.01
    assert spread[1] < 0.0015


def test_a_fingertip_that_was_not_seen_is_no_data(generator: torch.Generator) -> None:
    starts = hands(generator, 2)
    [ray] = rays(tips(starts)[0], 1)
    missing = replace(ray, direction=torch.full((3,), torch.nan).double())
    assert solve(problem((missing,), starts), starts, SCHEDULE).status.tolist() == [SolveStatus.NO_DATA] * 2
    both = solve(problem((ray, missing), starts), starts, SCHEDULE)
    alone = solve(problem((ray,), starts), starts, SCHEDULE)
    assert torch.equal(both.pose.dofs, alone.pose.dofs)


@pytest.mark.parametrize("cameras", [1, 4])
def test_the_shape_fit_takes_it_as_it_is(cameras: int, generator: torch.Generator) -> None:
    """Four frames of a hand 6 % longer than the start, its poses known to a degree and to half a millimetre: the length
    comes back."""
    space, frames = MODEL.shape_space, 4
    length, start = space.names.index("hand_length"), KINEMATICS.default_shape
    longer = start.clone()
    longer[length] *= 1.06
    truth = hands(generator, frames)
    own = [rays(tip, cameras) for tip in tips(truth, longer)]
    observations = tuple(FrameObservations(frames=tuple(frame[i] for frame in own)) for i in range(cameras))
    shared = replace(
        problem(observations, truth),
        priors=(expected(truth, 0.005),),
        shared=SharedUnknowns.of_shape(Anthropometry(space), (length,)),
    )
    found = solve_shared(shared, truth, SCHEDULE)
    assert abs(float(found.shape[length] / longer[length]) - 1) < 0.004
    assert 0 < float(found.shape_std[length]) < 0.001
    assert [one.view for one in found.explained] == list(range(cameras))
    assert all(bool(one.fraction.all()) for one in found.explained)
