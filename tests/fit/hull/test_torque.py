"""The fit of Ueda et al. 2003: torques turn the joints into the hull; limits, palm and history."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit.hull.settings import HullTorqueSettings
from torchhand.fit.hull.skin import SkinPoints
from torchhand.fit.hull.torque import HullTorqueFit, fit_by_torques
from torchhand.hand import DOFS, HandPose, named_pose_space, pose_space, posture

INDEX = DOFS.index("index_mcp_fe")


def flat(deg: float) -> Tensor:
    """A flat hand in the middle of the rig with its index bent at the knuckle."""
    pose = posture("flat", dtype=torch.float64)
    pose[1] = 0.09
    pose[INDEX] = math.radians(deg)
    return pose


def pulled(rig: Any, free: tuple[str, ...], level: int, **settings: Any) -> HullTorqueFit:
    target = rig.target(HandPose.of(flat(10), rig.upright), level=level)
    space = pose_space("free", free).about(flat(0))
    settings = {"outside_fraction": 0.0} | settings
    start = HandPose.of(flat(0), rig.upright)
    return fit_by_torques(target.field, SkinPoints(rig.hand), space, start, HullTorqueSettings(**settings))


class Behind:
    """A hull far behind the back of the hand."""

    def __init__(self, back: Tensor) -> None:
        self.back = back

    def sample(self, points: Tensor, /) -> tuple[Tensor, Tensor]:
        return (0.3 - points @ self.back), -self.back.expand_as(points)


KNUCKLES = tuple(name for name in DOFS if name.endswith(("mcp_fe", "mcp_aa")))


@pytest.mark.parametrize(("level", "max_deg"), [(7, 1.0), (8, 0.5)])
def test_index_bent_by_ten_degrees(rig: Any, level: int, max_deg: float) -> None:
    """The experiment of section 6.3; the paper shows its figures for levels 7 and 8 only as curves."""
    found = pulled(rig, KNUCKLES, level)
    error = (found.poses.dofs[:, INDEX].rad2deg() - 10).abs()
    assert float(error[0]) == pytest.approx(10)
    assert float(error[-1]) <= max_deg
    assert float(found.inside_fraction[-1]) > float(found.inside_fraction[0])
    assert found.inside_fraction.shape == (21,)


FINGERS = tuple(name for name in named_pose_space("dof31").free_names if not name.startswith("root"))


@pytest.mark.parametrize(("level", "max_deg"), [(7, 1.0), (8, 0.5)])
def test_index_bent_by_ten_degrees_with_all_joints_free(rig: Any, level: int, max_deg: float) -> None:
    found = pulled(rig, FINGERS, level)
    error = (found.pose.dofs - flat(10)).rad2deg().abs()
    assert float(error[INDEX]) <= max_deg
    assert float(error[6:].mean()) <= 0.8


def test_printed_steps_turn_every_angle_by_the_same(rig: Any) -> None:
    joints = ("index_mcp_fe", "index_pip_fe", "index_dip_fe")
    found = pulled(rig, joints, 7, iterations=3, steps="equal", step_deg=0.5, min_step_deg=0.5)
    columns = [DOFS.index(name) for name in joints]
    steps = found.poses.dofs[:, columns].rad2deg().diff(dim=0)
    assert torch.allclose(steps, torch.full((3, 3), 0.5, dtype=torch.float64))
    fixed = [i for i in range(36) if i not in columns]
    assert torch.equal(found.poses.dofs[:, fixed], flat(0)[fixed].expand(4, -1))


def test_the_largest_torque_of_each_digit_moves_alone(rig: Any) -> None:
    found = pulled(rig, FINGERS, 7, iterations=1)
    moved = [DOFS[i] for i in (found.poses.dofs[1] != found.poses.dofs[0]).nonzero()[:, 0].tolist()]
    assert "index_mcp_fe" in moved
    digits = [name.partition("_")[0] for name in moved]
    assert len(digits) == len(set(digits))
    assert float(found.poses.dofs[1, INDEX].rad2deg()) == pytest.approx(1.0)


def test_a_digit_at_its_limit_lets_its_other_angles_move(rig: Any) -> None:
    """Or the knuckle, whose torque stays the largest, would keep the finger where it is."""
    start = flat(0)
    start[INDEX] = rig.model.skeleton.lower[INDEX - 6]
    space = pose_space("free", FINGERS).about(start)
    settings = HullTorqueSettings(iterations=2)
    found = fit_by_torques(
        Behind(rig.upright[:, 0]), SkinPoints(rig.hand), space, HandPose.of(start, rig.upright), settings
    )
    turned = (found.pose.dofs - found.poses.dofs[0]).rad2deg()
    assert float(turned[INDEX]) == 0
    assert float(turned[DOFS.index("index_pip_fe")]) == pytest.approx(-2.0)


def test_the_knuckle_by_each_reading(rig: Any) -> None:
    found = {steps: pulled(rig, FINGERS, 7, steps=steps) for steps in ("equal", "proportional", "largest")}
    errors = [abs(float(fit.pose.dofs[INDEX].rad2deg()) - 10) for fit in found.values()]
    assert errors[2] < errors[1] < errors[0] < 5


def test_stops_when_hardly_a_vertex_is_outside_and_stays(rig: Any) -> None:
    whole = pulled(rig, ("index_mcp_fe",), 7, slack_m=0.002)
    threshold = 0.5 * float(whole.inside_fraction[0] + whole.inside_fraction.max())
    first = int((whole.inside_fraction > threshold).nonzero()[0, 0])
    assert first > 0
    found = pulled(rig, ("index_mcp_fe",), 7, slack_m=0.002, outside_fraction=1 - threshold)
    assert bool(found.converged)
    assert int(found.iterations) == first
    assert torch.equal(found.poses.dofs[: first + 1], whole.poses.dofs[: first + 1])
    assert torch.equal(found.poses.dofs[first:], found.poses.dofs[-1].expand(21 - first, -1))
    assert float(found.inside_fraction[-1]) > threshold


def test_limits_hold(rig: Any) -> None:
    """The field's force would bend the finger backwards without end."""

    space = pose_space("index", ("index_mcp_fe",)).about(flat(0))
    settings = HullTorqueSettings(step_deg=5.0, iterations=30)
    found = fit_by_torques(
        Behind(rig.upright[:, 0]), SkinPoints(rig.hand), space, HandPose.of(flat(0), rig.upright), settings
    )
    lower = rig.model.skeleton.lower[INDEX - 6]
    assert float(found.pose.dofs[INDEX]) == pytest.approx(float(lower))
    assert not bool(found.converged)


def test_the_palm_moves_where_it_is_free(rig: Any) -> None:
    truth = HandPose.of(flat(0), rig.upright)
    shift = torch.tensor((0.006, -0.004, 0.005), dtype=torch.float64)
    start = truth.retract(torch.nn.functional.pad(shift, (0, 33)))
    found = fit_by_torques(rig.target(truth).field, SkinPoints(rig.hand), named_pose_space("dof31"), start)
    before, after = (rig.error_mm(pose, truth, None) for pose in (start, found.pose))
    assert before == pytest.approx(8.77, abs=0.01)
    assert after < 0.5 * before
    assert float(found.pose.dofs[3:6].abs().max()) == 0


def test_hypotheses_are_independent_and_bad_starts_are_kept(rig: Any) -> None:
    target = rig.target(HandPose.of(flat(10), rig.upright))
    space = pose_space("index", ("index_mcp_fe",)).about(flat(0))
    dofs = torch.stack((flat(0), flat(25), torch.full((36,), torch.nan, dtype=torch.float64)))
    starts, skin, settings = (
        HandPose.of(dofs[None], rig.upright),
        SkinPoints(rig.hand),
        HullTorqueSettings(iterations=6),
    )
    together = fit_by_torques(target.field, skin, space, starts, settings)
    assert together.pose.batch_shape == (1, 3)
    assert together.poses.batch_shape == (1, 3, 7)
    for index in range(2):
        alone = fit_by_torques(target.field, skin, space, starts[0][index], settings)
        assert torch.allclose(together.pose.dofs[0, index], alone.pose.dofs, atol=1e-12)
        assert torch.allclose(together.inside_fraction[0, index], alone.inside_fraction)
    assert not bool(together.converged[0, 2])
