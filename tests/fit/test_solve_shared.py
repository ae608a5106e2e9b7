"""Frames that share a shape: the known hand is found, covariances are those of the dense problem, parts and frames that
fail change nothing."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.device_guard import no_host_reads, on_device
from torchhand import devices
from torchhand.files import load_hand_model
from torchhand.fit import Problem, SharedUnknowns, SolveStatus, Stage, solve_shared
from torchhand.fit.keypoints import KeypointSettings, WorldKeypoints
from torchhand.geometry import rotation_from_vector
from torchhand.hand import Anthropometry, HandPose, named_pose_space, posture
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import RobustLoss
from torchhand.numerics.least_squares import Status

DOUBLE = torch.float64
SPACE = named_pose_space("dof27")
KINEMATICS = load_hand_model().kinematics(dtype=DOUBLE)
NAMES = KINEMATICS.shape_space.names
COLUMNS = tuple(NAMES.index(name) for name in ("hand_length", "index_proximal", "ring_middle"))
SCHEDULE = (Stage(gross_m=0.05, rounds=1, iterations=40),)
STD = 0.002


def _poses(count: int, seed: int, spread: float = 0.25) -> HandPose:
    generator = torch.Generator().manual_seed(seed)
    free = SPACE.free(posture("open", dtype=torch.float64))
    free = free + spread * torch.randn(count, SPACE.size, generator=generator, dtype=DOUBLE)
    dofs = clamp_to_limits(SPACE.dof(free), KINEMATICS.skeleton)
    dofs[:, 3:6] = 0
    return HandPose(dofs=dofs, reference=rotation_from_vector(torch.randn(count, 3, generator=generator, dtype=DOUBLE)))


def _shape() -> Tensor:
    shape = KINEMATICS.default_shape.clone()
    shape[list(COLUMNS)] *= torch.tensor((1.04, 0.95, 1.05), dtype=DOUBLE)
    return shape


def _points(pose: HandPose, shape: Tensor) -> Tensor:
    return KINEMATICS(pose.dofs, shape, root_reference=pose.reference).keypoints


def _problem(points: Tensor, *, is_shared: bool = True) -> Problem:
    observation = WorldKeypoints(
        points=points,
        kinematics=KINEMATICS,
        settings=KeypointSettings(space_std_m=STD, correlation=0.0),
        loss=RobustLoss(kind="huber", scale=5.0, group=3),
    )
    population = Anthropometry(KINEMATICS.shape_space)
    return Problem(
        space=SPACE,
        skeleton=KINEMATICS.skeleton,
        shape=KINEMATICS.default_shape,
        observations=(observation,),
        shared=SharedUnknowns.of_shape(population, COLUMNS) if is_shared else None,
    )


def _near(pose: HandPose, seed: int = 9) -> HandPose:
    step = 0.1 * torch.randn(len(pose), 36, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)
    step[:, :3] *= 0.1
    return pose.retract(step)


def test_one_shape_of_many_poses() -> None:
    truth, shape = _poses(12, 1), _shape()
    found = solve_shared(_problem(_points(truth, shape)), _near(truth), SCHEDULE, pose_tolerance=1e-8)
    score = ((found.shape - shape) / found.shape_std)[list(COLUMNS)]
    assert float(score.abs().max()) < 1.0  # points without noise: the belief in the population alone pulls
    assert float((_points(found.pose, found.shape) - _points(truth, shape)).norm(dim=-1).max()) < 2e-4
    assert not found.shape_std[[i for i in range(len(NAMES)) if i not in COLUMNS]].any()
    assert found.frame_status.tolist() == [SolveStatus.CONVERGED] * 12


def test_covariances_are_those_of_the_dense_problem() -> None:
    """Of all poses and what they share together, by automatic differentiation."""
    truth, shape = _poses(2, 2, spread=0.1), KINEMATICS.default_shape
    problem = _problem(_points(truth, shape))
    found = solve_shared(problem, truth, SCHEDULE)
    assert problem.shared is not None
    basis, columns = SPACE.basis, torch.tensor(COLUMNS)

    def residual(free: Tensor, own: Tensor) -> Tensor:
        dofs = found.pose.dofs.clone() + free @ basis.T
        grown = found.shape.clone().index_add(0, columns, own)
        return KINEMATICS(dofs, grown, root_reference=found.pose.reference.clone()).keypoints.flatten() / STD

    free, own = torch.zeros(2, SPACE.size, dtype=DOUBLE), torch.zeros(len(COLUMNS), dtype=DOUBLE)
    of_free, of_own = torch.autograd.functional.jacobian(residual, (free, own))
    rows = torch.cat((of_free.flatten(1), of_own), -1)
    matrix = rows.T @ rows
    prior = problem.shared.prior_equations(found.shape[columns], found.shape)
    matrix[-len(COLUMNS) :, -len(COLUMNS) :] += prior.matrix
    dense = torch.linalg.inv(matrix)
    for frame in range(2):
        place = slice(frame * SPACE.size, (frame + 1) * SPACE.size)
        expected = dense[place, place]
        torch.testing.assert_close(found.covariance[frame], expected, rtol=1e-5, atol=1e-7 * float(expected.max()))
        follow = -torch.linalg.solve(matrix[place, place], matrix[place, -len(COLUMNS) :])
        torch.testing.assert_close(found.follow[frame], follow, rtol=1e-4, atol=1e-6 * float(follow.abs().max()))
    torch.testing.assert_close(found.shared_covariance, dense[-3:, -3:], rtol=1e-5, atol=0)


def test_information_counts_in_the_covariances_alone() -> None:
    truth = _poses(3, 3)
    problem, known = _problem(_points(truth, _shape())), torch.full((36,), 50.0, dtype=DOUBLE)
    one = solve_shared(problem, _near(truth), SCHEDULE)
    two = solve_shared(problem, _near(truth), SCHEDULE, information=known)
    torch.testing.assert_close(one.pose.dofs, two.pose.dofs, rtol=0, atol=0)
    assert bool((two.covariance.diagonal(dim1=-2, dim2=-1) < one.covariance.diagonal(dim1=-2, dim2=-1)).all())
    assert float(two.covariance.diagonal(dim1=-2, dim2=-1).max()) < 1 / 50 * (1 + 1e-9)


@pytest.mark.parametrize("is_shared", [True, False])
def test_parts_change_nothing(is_shared: bool) -> None:
    truth = _poses(7, 4)
    points = _points(truth, _shape())
    points = points + STD * torch.randn(points.shape, generator=torch.Generator().manual_seed(0), dtype=DOUBLE)
    problem = _problem(points, is_shared=is_shared)
    whole = solve_shared(problem, _near(truth), SCHEDULE)
    parts = solve_shared(problem, _near(truth), SCHEDULE, at_once=3)
    torch.testing.assert_close(parts.shape, whole.shape, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(parts.pose.dofs, whole.pose.dofs, rtol=0, atol=1e-9)
    torch.testing.assert_close(parts.covariance, whole.covariance, rtol=1e-6, atol=1e-12)
    assert parts.cost == pytest.approx(whole.cost, rel=1e-9)


def test_without_shared_unknowns_every_frame_is_by_itself() -> None:
    truth = _poses(4, 5)
    points = _points(truth, KINEMATICS.default_shape)
    found = solve_shared(_problem(points, is_shared=False), _near(truth), SCHEDULE, pose_tolerance=1e-8)
    start = _near(truth)
    for frame in range(4):
        own = _problem(points[frame : frame + 1], is_shared=False)
        alone = solve_shared(own, start[frame : frame + 1], SCHEDULE, pose_tolerance=1e-8)
        torch.testing.assert_close(alone.pose.dofs[0], found.pose.dofs[frame], rtol=0, atol=1e-12)
        torch.testing.assert_close(alone.covariance[0], found.covariance[frame], rtol=1e-9, atol=1e-15)
    assert float((_points(found.pose, found.shape) - points).norm(dim=-1).max()) < 1e-8
    assert found.shared_covariance.shape == (0, 0)
    assert found.follow.shape == (4, SPACE.size, 0)


def test_a_frame_that_fails_tells_nothing() -> None:
    """Shape, poses and covariances of the others are what they are without it."""
    truth = _poses(5, 6)
    points = _points(truth, _shape())
    points = points + STD * torch.randn(points.shape, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)
    start = _near(truth)
    spoilt = points.clone()
    spoilt[2] *= 1e305
    found = solve_shared(_problem(spoilt), start, SCHEDULE)
    good = torch.tensor([0, 1, 3, 4])
    without = solve_shared(_problem(points[good]), start[good], SCHEDULE)
    assert found.frame_status[2] == SolveStatus.FAILED
    assert bool(found.covariance[2].isnan().all())
    torch.testing.assert_close(found.shape, without.shape, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(found.pose.dofs[good], without.pose.dofs, rtol=0, atol=1e-9)
    torch.testing.assert_close(found.covariance[good], without.covariance, rtol=1e-6, atol=1e-12)
    assert found.cost == pytest.approx(without.cost, rel=1e-9)


def test_where_all_frames_fail_nothing_moves() -> None:
    truth = _poses(2, 7)
    found = solve_shared(_problem(1e305 * _points(truth, _shape())), truth, SCHEDULE)
    torch.testing.assert_close(found.shape, KINEMATICS.default_shape, rtol=0, atol=0)
    torch.testing.assert_close(found.pose.dofs, truth.dofs, rtol=0, atol=1e-12)
    assert found.frame_status.tolist() == [SolveStatus.FAILED] * 2


def test_constraints_are_kept_exactly() -> None:
    """Of a hand that no person has: a middle finger with long bones, each of which is possible."""
    population, shape = Anthropometry(KINEMATICS.shape_space), KINEMATICS.default_shape.clone()
    bones = tuple(NAMES.index(f"middle_{bone}") for bone in ("proximal", "middle", "distal"))
    shape[list(bones)] *= torch.tensor((1.09, 1.14, 1.14), dtype=DOUBLE)
    assert population.violation(shape).describe().startswith("interval of middle_length")
    truth = _poses(6, 8)
    problem = _problem(_points(truth, shape))
    shared = SharedUnknowns.of_shape(population, bones)
    free = solve_shared(replace(problem, shared=shared), _near(truth), SCHEDULE)
    kept = solve_shared(replace(problem, shared=replace(shared, population=population)), _near(truth), SCHEDULE)
    assert not bool(population.is_feasible(free.shape))
    assert bool(population.is_feasible(kept.shape))
    changed = (kept.shape != KINEMATICS.default_shape).nonzero()[:, 0].tolist()
    assert set(changed) <= set(bones)


def test_no_trial_waits_for_its_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """As often in six trials of the shape as in one, with the processor treated as an accelerator: when the rounds
    end; and what comes out is what a processor finds, which asks itself all the time."""
    truth = _poses(3, 1)
    problem = _problem(_points(truth, _shape()))
    few, many = ((Stage(gross_m=0.05, rounds=1, iterations=count),) for count in (1, 6))
    expected = solve_shared(problem, _near(truth), many)
    monkeypatch.setattr(devices, "_HOSTS", ())
    solve_shared(problem, _near(truth), many)  # constants are sent once
    counts = []
    for stages in (few, many):
        with no_host_reads() as permitted:
            found = solve_shared(problem, _near(truth), stages)
        counts.append(permitted.count)
    assert counts[0] == counts[1] <= 6
    torch.testing.assert_close(found.shape, expected.shape, rtol=0, atol=1e-9)
    torch.testing.assert_close(found.pose.vector, expected.pose.vector, rtol=0, atol=1e-8)


def test_one_shape_on_a_device_is_that_of_the_processor(device: torch.device) -> None:
    """The problem, its frames and its constraints are on the device."""
    truth = _poses(3, 1)
    problem = _problem(_points(truth, _shape()))
    assert problem.shared is not None
    kept = replace(problem.shared, population=Anthropometry(KINEMATICS.shape_space))
    problem, stages = replace(problem, shared=kept), (Stage(gross_m=0.05, rounds=1, iterations=6),)
    expected = solve_shared(problem, _near(truth), stages)
    there, starts = on_device((problem, _near(truth)), device)
    found = solve_shared(there, starts, stages)
    assert found.shape.device.type == device.type
    torch.testing.assert_close(found.shape.cpu(), expected.shape, rtol=0, atol=1e-9)
    torch.testing.assert_close(found.pose.vector.cpu(), expected.pose.vector, rtol=0, atol=1e-8)
    torch.testing.assert_close(found.shared_covariance.cpu(), expected.shared_covariance, rtol=1e-6, atol=1e-12)


def test_error_messages() -> None:
    truth = _poses(2, 1)
    problem = _problem(_points(truth, _shape()))
    with pytest.raises(ValueError, match="schedule: expected at least one stage"):
        solve_shared(problem, truth, ())
    with pytest.raises(ValueError, match="problem: expected data and at least one frame"):
        solve_shared(_problem(torch.full((2, 21, 3), torch.nan, dtype=DOUBLE)), truth, SCHEDULE)
    with pytest.raises(ValueError, match="problem: expected data and at least one frame"):
        solve_shared(problem, truth[:0], SCHEDULE)


def test_single_steps_come_to_the_same_shape_and_poses() -> None:
    """Poses and shape stepped together, once after each association, end where Levenberg-Marquardt does, but for what a
    joint on its limit takes from the step of the others; a frame that fails tells nothing there either."""
    start, truth = _poses(4, 0), _shape()
    points = _points(start, truth)
    steps = (Stage(gross_m=0.05, rounds=30, iterations=1, method="gauss_newton"),)
    problem = _problem(points)
    expected = solve_shared(problem, start, SCHEDULE, cost_tolerance=1e-12, pose_tolerance=1e-12)
    found = solve_shared(problem, start, steps)
    assert found.cost <= expected.cost * (1 + 1e-4)
    off = (found.shape - expected.shape)[list(COLUMNS)] / expected.shape_std[list(COLUMNS)]
    assert float(off.abs().max()) < 1e-2
    torch.testing.assert_close(found.pose.dofs, expected.pose.dofs, rtol=0, atol=1e-3)
    assert found.status == Status.CONVERGED
    assert found.iterations == 30
    broken = points.clone()
    broken[2] = torch.nan
    without = solve_shared(_problem(broken), start, steps)
    assert without.frame_status.tolist()[2] == solve_shared(_problem(broken), start, SCHEDULE).frame_status.tolist()[2]
    three = torch.tensor([0, 1, 3])
    alone = solve_shared(_problem(points[three]), start[three], steps)
    torch.testing.assert_close(without.shape, alone.shape, rtol=0, atol=1e-9)
