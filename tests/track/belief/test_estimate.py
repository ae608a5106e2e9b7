"""What a tracker's belief says of the keypoints: the first order of the kinematics, to rounding."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandKinematics, Side, centre_covariance, named_pose_space
from torchhand.numerics import Gaussian, MotionModel
from torchhand.track.belief import FollowedHand, HandMotion, NoiseSettings, PosedBelief, posed_belief


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def motion_of(kinematics: HandKinematics, name: str) -> HandMotion:
    noise = NoiseSettings(translation=1.0, rotation=1.0, angle=1.0)
    space, model = named_pose_space(name), MotionModel(order=1, velocity_decay_s=0.1)
    return HandMotion(space=space, skeleton=kinematics.skeleton, model=model, noise=noise)


def hand_of(motion: HandMotion) -> FollowedHand:
    """A hand half bent, turned by half a radian about its reference, and a belief with correlations."""
    size, limits = motion.space.size, motion.skeleton
    base = torch.cat((torch.zeros(6, dtype=torch.float64), 0.6 * limits.lower + 0.4 * limits.upper))
    base[:3] = torch.tensor([0.02, -0.01, 0.5])
    base[3:6] = torch.tensor([0.3, -0.2, 0.35])
    root = 0.02 * randn(2 * size, 2 * size, seed=1)
    mean = torch.cat((0.01 * randn(size, seed=2), torch.zeros(size, dtype=torch.float64)))
    reference = rotation_from_vector(torch.tensor([0.4, 1.0, -0.5], dtype=torch.float64))
    belief = Gaussian(mean, root @ root.mT)
    return FollowedHand(belief=belief, base=base, reference=reference, start_reference=torch.eye(3).double())


def posed(kinematics: HandKinematics, motion: HandMotion, hand: FollowedHand) -> PosedBelief:
    return posed_belief(hand, motion, kinematics, kinematics.default_shape)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", ["dof26", "dof27", "dof31", "planar_scale"])
def test_covariances_are_those_of_the_derivative_by_automatic_differentiation(side: Side, name: str) -> None:
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    motion = motion_of(kinematics, name)
    space, state = motion.space, hand_of(motion)
    got = posed(kinematics, motion, state)
    about, free = space.about(state.base), state.belief.mean[: space.size]
    low, high = kinematics.skeleton.lower, kinematics.skeleton.upper
    assert bool(((about.dof(free)[6:] > low) & (about.dof(free)[6:] < high)).all())

    def keypoints(values: Tensor) -> Tensor:
        return kinematics(about.dof(values), kinematics.default_shape, root_reference=state.reference).keypoints

    jacobian = torch.func.jacrev(keypoints)(free)
    covariance = state.belief.covariance[: space.size, : space.size]
    centres = centre_covariance(got.keypoints)
    expected = jacobian @ covariance @ jacobian.mT + centres
    torch.testing.assert_close(got.keypoints_cov, expected, rtol=1e-11, atol=1e-16)
    torch.testing.assert_close(got.keypoints, keypoints(free), rtol=0, atol=1e-15)


def test_an_overconfident_belief_is_spread_and_joint_centres_stay() -> None:
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    motion = motion_of(kinematics, "dof27")
    state = hand_of(motion)
    one = posed(kinematics, motion, state)
    other = posed_belief(state, motion, kinematics, kinematics.default_shape, overconfidence=4.0)
    centres = centre_covariance(one.keypoints)
    torch.testing.assert_close(other.pose_std, 2 * one.pose_std)
    torch.testing.assert_close(other.keypoints_cov - centres, 4 * (one.keypoints_cov - centres))
    torch.testing.assert_close(other.pose, one.pose, rtol=0, atol=0)


def test_an_angle_that_stopped_at_its_limit_moves_nothing() -> None:
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    motion = motion_of(kinematics, "dof27")
    state = hand_of(motion)
    column = motion.space.free_names.index("index_pip_fe")
    mean = state.belief.mean.clone()
    mean[column] = 10.0
    stopped = posed(kinematics, motion, replace(state, belief=replace(state.belief, mean=mean)))
    covariance = state.belief.covariance.clone()
    covariance[column], covariance[:, column] = 0.0, 0.0
    known = posed(kinematics, motion, replace(state, belief=Gaussian(mean, covariance)))
    assert float(stopped.pose_std[DOFS.index("index_pip_fe")]) == 0.0
    torch.testing.assert_close(stopped.keypoints_cov, known.keypoints_cov, rtol=1e-12, atol=0)
    free = posed(kinematics, motion, state)
    assert float(free.pose_std[DOFS.index("index_pip_fe")]) > 0.01
