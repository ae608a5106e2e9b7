"""Planar motion: constant offsets cancel, known errors are found."""

import numpy as np

from torchhand.evaluate.planar_motion import planar_motion_errors


def turn(angle_deg: np.ndarray | float) -> np.ndarray:
    angle = np.radians(angle_deg)
    return np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(*np.shape(angle), 2, 2)


def moving(base: np.ndarray, angle_deg: np.ndarray, shift: np.ndarray, scale: np.ndarray | float = 1.0) -> np.ndarray:
    return np.reshape(scale, (-1, 1, 1)) * base @ np.swapaxes(turn(angle_deg), -1, -2) + shift[:, None, :]


RNG = np.random.default_rng(0)
HAND = RNG.uniform(50.0, 150.0, (21, 2))
OTHER_HAND = HAND + RNG.normal(0.0, 6.0, (21, 2))
ANGLE = np.array([0.0, 10.0, -25.0, 170.0])
SHIFT = np.array([[0.0, 0.0], [5.0, -3.0], [20.0, 8.0], [300.0, 100.0]])


def test_other_joint_centres_with_the_same_motion_are_no_error() -> None:
    errors = planar_motion_errors(moving(OTHER_HAND, ANGLE, SHIFT), moving(HAND, ANGLE, SHIFT))
    assert errors is not None
    assert errors.reference == 0
    for values in (
        errors.rotation_deg,
        errors.displacement_px,
        errors.displacement_with_scale_px,
        errors.scale_percent,
    ):
        assert np.isnan(values[0])
        np.testing.assert_allclose(values[1:], np.zeros(3), atol=1e-10)


def test_known_errors_are_found() -> None:
    """Frame 1 is turned by 2° about the truth's own centroid, frame 2 shifted by (3, 4), frame 3 scaled by 1.1."""
    truth = moving(HAND, ANGLE, SHIFT)
    estimate = truth.copy()
    centre = truth.mean(axis=1)
    estimate[1] = (truth[1] - centre[1]) @ turn(2.0).T + centre[1]
    estimate[2] = truth[2] + [3.0, 4.0]
    estimate[3] = 1.1 * (truth[3] - centre[3]) + centre[3]
    errors = planar_motion_errors(estimate, truth)
    assert errors is not None
    np.testing.assert_allclose(errors.rotation_deg[1:], [2.0, 0.0, 0.0], atol=1e-10)
    np.testing.assert_allclose(errors.displacement_px[1:], [0.0, 5.0, 0.0], atol=1e-10)
    np.testing.assert_allclose(errors.scale_percent[1:], [0.0, 0.0, 10.0], atol=1e-10)


def test_rotation_errors_wrap() -> None:
    truth = moving(HAND, np.array([0.0, 179.0]), SHIFT[:2])
    errors = planar_motion_errors(moving(HAND, np.array([0.0, -179.0]), SHIFT[:2]), truth)
    assert errors is not None
    np.testing.assert_allclose(errors.rotation_deg[1], 2.0, atol=1e-10)


def test_the_common_point_is_the_truths_centroid() -> None:
    """A turn of the whole picture about its origin moves the centroid by a known chord."""
    truth = moving(HAND, np.zeros(2), np.zeros((2, 2)))
    errors = planar_motion_errors(moving(OTHER_HAND, np.array([0.0, 3.0]), np.zeros((2, 2))), truth)
    assert errors is not None
    chord = 2.0 * np.sin(np.radians(1.5)) * np.linalg.norm(HAND.mean(axis=0))
    np.testing.assert_allclose(errors.displacement_px[1], chord, rtol=1e-12)


def test_a_motion_in_depth_is_evaluated_with_scale() -> None:
    scale = np.array([1.0, 1.2, 0.7, 0.9])
    truth, estimate = moving(HAND, ANGLE, SHIFT, scale), moving(OTHER_HAND + 20.0, ANGLE, SHIFT, scale)
    errors = planar_motion_errors(estimate, truth)
    assert errors is not None
    np.testing.assert_allclose(errors.displacement_with_scale_px[1:], np.zeros(3), atol=1e-10)
    np.testing.assert_allclose(errors.scale_percent[1:], np.zeros(3), atol=1e-10)
    np.testing.assert_allclose(errors.true_scale, scale, rtol=1e-12)
    assert errors.displacement_px[1:].min() > 1.0


def test_the_first_known_frame_is_the_reference() -> None:
    estimate = moving(OTHER_HAND, ANGLE, SHIFT)
    estimate[0] = np.nan
    errors = planar_motion_errors(estimate, moving(HAND, ANGLE, SHIFT))
    assert errors is not None
    assert errors.reference == 1
    assert np.isfinite(errors.displacement_px).tolist() == [False, False, True, True]
    np.testing.assert_allclose(errors.displacement_px[2:], np.zeros(2), atol=1e-10)


def test_a_hand_that_was_never_seen_has_no_motion() -> None:
    assert planar_motion_errors(np.full((2, 21, 2), np.nan), moving(HAND, ANGLE[:2], SHIFT[:2])) is None
