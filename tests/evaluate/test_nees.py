"""NEES of errors drawn from known covariances."""

import numpy as np

from torchhand.evaluate.nees import consistency, fraction_in_band, normalised_errors_squared


def random_covariances(rng: np.random.Generator, *batch: int) -> tuple[np.ndarray, np.ndarray]:
    roots = 1e-3 * rng.normal(size=(*batch, 3, 3))
    return roots, roots @ np.swapaxes(roots, -1, -2)


def test_nees_is_the_quadratic_form() -> None:
    rng = np.random.default_rng(0)
    _, covariance = random_covariances(rng, 2, 3)
    errors = rng.normal(size=(2, 3, 3))
    nees, rank = normalised_errors_squared(errors, covariance)
    expected = np.einsum("abi,abij,abj->ab", errors, np.linalg.inv(covariance), errors)
    np.testing.assert_allclose(nees, expected, rtol=1e-6)  # the covariances' condition reaches 1e6
    assert (rank == 3).all()


def test_honest_covariances_are_inside_and_wrong_ones_are_not() -> None:
    rng = np.random.default_rng(1)
    roots, covariance = random_covariances(rng, 400, 21)
    errors = (roots @ rng.normal(size=(400, 21, 3, 1)))[..., 0]
    honest = consistency(errors, covariance)
    overconfident = consistency(errors, covariance / 9.0)
    timid = consistency(errors, covariance * 9.0)
    assert honest is not None
    assert overconfident is not None
    assert timid is not None
    assert honest.samples == 8400
    # 8400 independent draws: the share's standard deviation is 0.24 %; 5 of them.
    assert abs(honest.fraction_inside - 0.95) < 0.012
    assert honest.pooled_band[0] < 1.0 < honest.pooled_band[1]
    assert abs(honest.mean_per_dof - 1.0) < 5.0 * np.sqrt(2.0 / (3 * 8400))
    np.testing.assert_allclose(overconfident.mean_per_dof, 9.0 * honest.mean_per_dof, rtol=1e-9)
    assert overconfident.fraction_inside < 0.5
    assert timid.fraction_inside < 0.8


def test_a_covariance_of_a_planar_hand_is_evaluated_in_its_plane() -> None:
    covariance = np.diag([4.0, 9.0, 0.0])
    nees, rank = normalised_errors_squared(np.array([2.0, 3.0, 100.0]), covariance)
    assert rank == 2
    np.testing.assert_allclose(nees, 2.0)
    found = consistency(np.array([[2.0, 3.0, 100.0]]), covariance[None])
    assert found is not None
    assert (found.mean_rank, found.fraction_inside) == (2.0, 1.0)


def test_lost_frames_and_zero_covariances_do_not_count() -> None:
    errors = np.array([[1.0, 0, 0], [np.nan, 0, 0], [1.0, 0, 0], [1.0, 0, 0]])
    covariance = np.stack([np.eye(3), np.eye(3), np.full((3, 3), np.nan), np.zeros((3, 3))])
    nees, rank = normalised_errors_squared(errors, covariance)
    np.testing.assert_array_equal(nees, [1.0, np.nan, np.nan, np.nan])
    assert rank.tolist() == [3, 0, 0, 0]
    found = consistency(errors, covariance)
    assert found is not None
    assert found.samples == 1
    assert consistency(errors[1:], covariance[1:]) is None


def test_the_region_holds_95_percent_of_honest_points_and_counts_only_known_ones() -> None:
    rng = np.random.default_rng(4)
    roots, covariance = random_covariances(rng, 400, 21)
    errors = (roots @ rng.normal(size=(400, 21, 3, 1)))[..., 0]
    errors[:, 3] = np.nan
    covariance[:, 4] = 0.0
    inside, weight = fraction_in_band(errors, covariance)
    assert (weight[:, [3, 4]] == 0).all()
    assert (inside[:, [3, 4]] == 0).all()
    # 400 draws a point: the share's standard deviation is 1.1 %; 5 of them.
    assert np.abs(np.delete(inside, [3, 4], 1).mean(0) - 0.95).max() < 0.055
    inside, _ = fraction_in_band(0 * errors, covariance)
    assert np.delete(inside, [3, 4], 1).all()  # no error is too small
