"""Limits of joints, ties and rates after an update."""

from typing import Any

import pytest
import torch

from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandPose, named_pose_space
from torchhand.numerics import Gaussian, MotionModel
from torchhand.track.belief import FollowedHand, HandMotion, NoiseSettings


def _motion(placed: Any, name: str) -> HandMotion:
    return HandMotion(
        space=named_pose_space(name),
        skeleton=placed.kinematics.skeleton,
        model=MotionModel(order=1),
        noise=NoiseSettings(),
    )


def _hand(placed: Any, count: int) -> FollowedHand:
    root = torch.randn(2 * count, 2 * count, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    belief = Gaussian(torch.zeros(2 * count, dtype=torch.float64), 0.01 * root @ root.mT)
    return FollowedHand(
        belief=belief, base=placed.pose, reference=placed.root_reference, start_reference=placed.root_reference
    )


@pytest.mark.parametrize("name", ["dof26", "dof27", "dof36", "planar_abduction"])
def test_poses_stay_within_the_limits_and_free_angles_are_the_poses(studio: Any, name: str) -> None:
    placed = studio.placed()
    motion = _motion(placed, name)
    space, hand = motion.space, _hand(placed, motion.space.size)
    generator = torch.Generator().manual_seed(2)
    hand.belief.mean.copy_(torch.randn(2 * space.size, generator=generator, dtype=torch.float64))
    after = motion.limited(hand)
    pose, skeleton = motion.pose(after).dofs, placed.kinematics.skeleton
    assert bool((pose[6:] >= skeleton.lower - 1e-12).all() & (pose[6:] <= skeleton.upper + 1e-12).all())
    own = space.about(hand.base).own(pose)
    is_joint = torch.tensor([not n.startswith("root_") for n in space.free_names])
    torch.testing.assert_close(after.belief.mean[: space.size][is_joint], own[is_joint], atol=1e-12, rtol=0)
    assert not bool(pose[3:6].any())
    again = motion.limited(after)
    torch.testing.assert_close(again.belief.mean, after.belief.mean, atol=1e-12, rtol=0)
    torch.testing.assert_close(again.reference, after.reference, atol=1e-12, rtol=0)


def test_the_rotation_moves_into_the_reference_and_rates_at_a_limit_stop(studio: Any) -> None:
    placed = studio.placed()
    motion = _motion(placed, "dof26")
    space, hand = motion.space, _hand(placed, motion.space.size)
    hand.belief.covariance.copy_(torch.eye(2 * space.size, dtype=torch.float64))
    names = list(space.free_names)
    bent, tilt = names.index("index_pip_fe"), names.index("root_rx")
    mean = hand.belief.mean
    mean[bent], mean[space.size + bent], mean[tilt], mean[space.size + tilt] = 9.0, 2.0, 0.3, 0.7
    after = motion.limited(hand)
    upper = float(placed.kinematics.skeleton.upper[DOFS.index("index_pip_fe") - 6])
    assert float(motion.pose(after).dofs[DOFS.index("index_pip_fe")]) == pytest.approx(upper, abs=1e-12)
    assert float(after.belief.mean[space.size + bent]) == 0
    assert float(after.belief.mean[space.size + tilt]) == pytest.approx(0.7)
    turned = rotation_from_vector(torch.tensor([0.3, 0.0, 0.0], dtype=torch.float64)) @ placed.root_reference
    torch.testing.assert_close(after.reference, turned, atol=1e-12, rtol=0)


def test_a_tied_angle_stops_while_the_free_one_goes_on(studio: Any) -> None:
    placed = studio.placed()
    motion = _motion(placed, "dof26")
    space, hand = motion.space, _hand(placed, motion.space.size)
    hand.belief.covariance.copy_(torch.eye(2 * space.size, dtype=torch.float64))
    free = list(space.free_names).index("thumb_cmc_fe")
    hand.belief.mean[free] = -0.2
    after = motion.limited(hand)
    pose, base = motion.pose(after).dofs, placed.pose
    at = DOFS.index("thumb_mcp_fe")
    assert float(pose[DOFS.index("thumb_cmc_fe")]) == pytest.approx(float(base[DOFS.index("thumb_cmc_fe")]) - 0.2)
    assert float(pose[at]) == pytest.approx(float(placed.kinematics.skeleton.lower[at - 6]), abs=1e-12)
    assert float(space.about(base).dof(after.belief.mean[: space.size])[at]) < float(pose[at]) - 0.05


def test_an_unseen_hand_goes_on_at_its_speed_and_grows_uncertain(studio: Any) -> None:
    placed = studio.placed()
    motion = _motion(placed, "dof26")
    hand = _hand(placed, motion.space.size)
    hand.belief.mean[motion.space.size] = 0.6  # along x
    after = motion.predicted(hand, 0.5)
    assert float(after.belief.mean[0]) == pytest.approx(0.3)
    assert float(motion.pose(after).dofs[0] - placed.pose[0]) == pytest.approx(0.3)
    assert bool((after.belief.covariance.diagonal() > hand.belief.covariance.diagonal()).any())
    assert after.frames == hand.frames + 1


def test_parameters_that_are_put_elsewhere_are_as_uncertain_as_they_moved(studio: Any) -> None:
    placed = studio.placed(size=0.8)
    motion = _motion(placed, "dof27")
    hand = motion.started(HandPose(dofs=placed.pose, reference=placed.root_reference))
    bent = motion.pose(hand).dofs.clone()
    names = ("index_pip_fe", "middle_pip_fe")
    rows = [DOFS.index(name) for name in names]
    bent[rows] += 0.8
    is_put = torch.tensor([name == names[0] for name in motion.space.free_names])
    moved = motion.put(hand, HandPose(dofs=bent, reference=hand.reference), is_put)
    change = (motion.pose(moved).dofs - motion.pose(hand).dofs)[rows]
    torch.testing.assert_close(change, change.new_tensor((0.8, 0.0)))
    variance = (moved.belief.covariance - hand.belief.covariance).diagonal()[: motion.space.size]
    torch.testing.assert_close(variance[is_put], variance.new_tensor([0.8**2]))
    assert not bool(variance[~is_put].any())
