"""Position errors of hands moved by known amounts."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from torchhand.evaluate.alignment import fit_similarity
from torchhand.evaluate.positions import (
    aligned_errors,
    fingertip_distances,
    fingertip_errors,
    joint_errors,
    root_relative_errors,
)


def hand(*batch: int) -> np.ndarray:
    return np.random.default_rng(0).normal(scale=0.05, size=(*batch, 21, 3))


def test_a_shift_is_a_position_error_and_no_root_relative_one() -> None:
    truth = hand(2)
    shifted = truth + [0.003, 0.0, 0.004]
    np.testing.assert_allclose(joint_errors(shifted, truth), np.full((2, 21), 0.005), rtol=1e-12)
    np.testing.assert_allclose(root_relative_errors(shifted, truth), np.zeros((2, 21)), atol=1e-15)


def test_a_wrist_error_moves_all_other_joints_relative_to_it() -> None:
    truth = hand()
    estimate = truth.copy()
    estimate[0] += [0.0, 0.002, 0.0]
    np.testing.assert_allclose(root_relative_errors(estimate, truth), [0.0] + [0.002] * 20, atol=1e-15)


def test_a_similarity_is_no_aligned_error() -> None:
    truth = hand(2, 3)
    moved = 1.3 * truth @ Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix().T + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(aligned_errors(moved, truth), np.zeros((2, 3, 21)), atol=1e-14)
    assert joint_errors(moved, truth).min() > 1.0


def test_the_aligned_error_of_a_known_case() -> None:
    # A square of half-diagonal 1 in the plane z = 0 whose corners are lifted by ±h in turn: no motion undoes that and
    # the rotation stays 1, so the best scale of the estimate is 1 / (1 + h²) and what is left is by hand:
    h = 0.1
    truth = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    estimate = truth + np.array([[0, 0, h], [0, 0, -h], [0, 0, h], [0, 0, -h]])
    scale = 1.0 / (1.0 + h**2)
    expected = np.hypot(1.0 - scale, scale * h)
    np.testing.assert_allclose(aligned_errors(estimate, truth), np.full(4, expected), rtol=1e-12)


def test_lost_frames_are_nan() -> None:
    truth = hand(3)
    estimate = truth.copy()
    estimate[1] = np.nan
    for errors in (joint_errors, root_relative_errors, aligned_errors):
        assert np.isnan(errors(estimate, truth)).all(axis=-1).tolist() == [False, True, False]


def test_fingertips_are_judged_wherever_the_hand_is() -> None:
    """A hand that is moved and turned has no wrong finger; one whose index is elsewhere has that one."""
    generator = np.random.default_rng(0)
    points = generator.normal(0, 0.05, (21, 3))
    turn = fit_similarity(points, generator.normal(0, 1, (21, 3)), with_scale=False).rotation
    moved = points @ turn.T + (0.1, -0.2, 0.3)
    assert fingertip_errors(moved, points).max() < 1e-12
    moved[8] += turn @ (0.0, 0.03, 0.0)
    errors = fingertip_errors(moved, points)
    assert errors[1] > 0.02
    assert np.delete(errors, 1).max() < 0.01


def test_one_camera_does_not_judge_along_the_line_of_sight() -> None:
    points = np.random.default_rng(0).normal(0, 0.05, (2, 21, 3)) + (0, 0, 0.5)
    farther = 1.1 * points
    assert fingertip_distances(farther, points, is_one_camera=True).max() < 1e-12
    assert fingertip_distances(farther, points, is_one_camera=False).min() > 0.04
    aside = points + (0.03, 0, 0)
    assert fingertip_distances(aside, points, is_one_camera=True) == pytest.approx(0.03)
