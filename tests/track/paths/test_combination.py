"""One hand from several with probabilities: mean, covariance, and what lies too far apart for a mean."""

import math
from dataclasses import replace

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import DOFS, HandKinematics
from torchhand.track import PosedHand, combined_hand

BEND, TILT = DOFS.index("index_pip_fe"), DOFS.index("root_rx")


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics(dtype=torch.float64)


def _hand(kinematics: HandKinematics, **angles: float) -> PosedHand:
    pose = torch.zeros(36, dtype=torch.float64)
    pose[2] = 0.5
    for name, value in angles.items():
        pose[DOFS.index(name)] = value
    std = torch.zeros(36, dtype=torch.float64)
    std[[BEND, TILT]] = 0.1
    return PosedHand(
        pose=pose,
        pose_std=std,
        keypoints=kinematics(pose, kinematics.default_shape).keypoints,
        keypoints_cov=4e-6 * torch.eye(3, dtype=torch.float64).expand(21, 3, 3),
    )


def _combined(kinematics: HandKinematics, hands: list[PosedHand], *weights: float) -> PosedHand:
    return combined_hand(hands, torch.tensor(weights, dtype=torch.float64), kinematics, kinematics.default_shape)


def test_a_hand_that_both_passes_agree_on_stays_as_sure_as_it_was(kinematics: HandKinematics) -> None:
    hand = _hand(kinematics, index_pip_fe=0.4, root_rx=0.3)
    both = _combined(kinematics, [hand, hand], 0.3, 0.7)
    for name in ("pose", "pose_std", "keypoints", "keypoints_cov"):
        torch.testing.assert_close(getattr(both, name), getattr(hand, name), rtol=0, atol=1e-12)


def test_hands_near_each_other_are_averaged_and_their_difference_is_in_the_spread(kinematics: HandKinematics) -> None:
    one, other = _hand(kinematics, index_pip_fe=0.4), _hand(kinematics, index_pip_fe=0.6, root_rx=0.1)
    both = _combined(kinematics, [one, other], 0.25, 0.75)
    assert float(both.pose[BEND]) == pytest.approx(0.55)
    assert float(both.pose[TILT]) == pytest.approx(0.075)
    assert float(both.pose_std[BEND]) == pytest.approx(math.sqrt(0.1**2 + 0.25 * 0.75 * 0.2**2))
    expected = kinematics(both.pose, kinematics.default_shape).keypoints
    torch.testing.assert_close(both.keypoints, expected, rtol=0, atol=1e-12)
    assert bool((torch.linalg.eigvalsh(both.keypoints_cov - one.keypoints_cov) > -1e-15).all())


def test_turns_are_averaged_on_the_sphere(kinematics: HandKinematics) -> None:
    one = _hand(kinematics, root_rx=3.1)
    turned = rotation_from_vector(torch.tensor([0.1, 0.0, 0.0], dtype=torch.float64)) @ rotation_from_vector(
        one.pose[3:6]
    )
    pose = one.pose.clone()
    pose[3:6] = vector_from_rotation(turned)  # beyond half a turn: the vector points the other way
    assert float(pose[TILT]) < 0
    other = replace(one, pose=pose, keypoints=kinematics(pose, kinematics.default_shape).keypoints)
    both = _combined(kinematics, [one, other], 0.5, 0.5)
    halfway = rotation_from_vector(torch.tensor([3.15, 0.0, 0.0], dtype=torch.float64))
    torch.testing.assert_close(rotation_from_vector(both.pose[3:6]), halfway, rtol=0, atol=1e-9)


def test_of_hands_far_apart_the_likelier_one_is_told_and_the_other_is_in_its_spread(kinematics: HandKinematics) -> None:
    palm, back = _hand(kinematics), _hand(kinematics, root_ry=3.0)
    both = _combined(kinematics, [palm, back], 0.6, 0.4)
    torch.testing.assert_close(both.pose, palm.pose, rtol=0, atol=1e-12)
    offset = back.keypoints - palm.keypoints
    expected = palm.keypoints_cov + 0.4 * offset[..., :, None] * offset[..., None, :]
    torch.testing.assert_close(both.keypoints_cov, expected, rtol=0, atol=1e-12)


def test_a_hand_at_another_distance_is_averaged_all_the_same(kinematics: HandKinematics) -> None:
    near = _hand(kinematics)
    far = _hand(kinematics, root_tz=0.6)
    both = _combined(kinematics, [near, far], 0.5, 0.5)
    assert float(both.pose[2]) == pytest.approx(0.55)
