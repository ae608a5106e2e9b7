"""Known motions are found again, mirrors are refused, NaN stays NaN."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from torchhand.evaluate.alignment import fit_similarity


def random_motion(
    rng: np.random.Generator, d: int, batch: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if d == 3:
        rotation = Rotation.from_quat(rng.normal(size=(*batch, 4)).reshape(-1, 4)).as_matrix().reshape(*batch, 3, 3)
    else:
        angle = rng.uniform(-np.pi, np.pi, batch)
        rotation = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(*batch, 2, 2)
    return rotation, rng.uniform(0.5, 2.0, batch), rng.normal(size=(*batch, d))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_a_known_similarity_is_found(d: int, batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    rotation, scale, translation = random_motion(rng, d, batch)
    source = rng.normal(size=(*batch, 7, d))
    target = np.asarray(scale)[..., None, None] * source @ np.swapaxes(rotation, -1, -2) + translation[..., None, :]
    found = fit_similarity(source, target, with_scale=True)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(found.scale, scale, rtol=1e-12)
    np.testing.assert_allclose(found.translation, translation, atol=1e-12)
    np.testing.assert_allclose(found.apply(source), target, atol=1e-12)


def test_the_rigid_fit_is_the_least_squares_one_of_scipy() -> None:
    rng = np.random.default_rng(1)
    source, target = rng.normal(size=(2, 9, 3))
    found = fit_similarity(source, target, with_scale=False)
    reference = Rotation.align_vectors(target - target.mean(0), source - source.mean(0))[0]
    np.testing.assert_allclose(found.rotation, reference.as_matrix(), atol=1e-12)
    assert found.scale == 1.0


def test_no_small_change_of_the_similarity_is_better() -> None:
    rng = np.random.default_rng(2)
    source, target = rng.normal(size=(2, 9, 2))
    found = fit_similarity(source, target, with_scale=True)
    best = np.sum((found.apply(source) - target) ** 2)
    turned = found.rotation @ np.array([[np.cos(1e-3), -np.sin(1e-3)], [np.sin(1e-3), np.cos(1e-3)]])
    for rotation, scale, shift in [(turned, 1.0, 0.0), (found.rotation, 1.001, 0.0), (found.rotation, 1.0, 1e-3)]:
        moved = scale * found.scale * source @ rotation.T + found.translation + shift
        assert np.sum((moved - target) ** 2) > best


def test_a_mirrored_hand_is_turned_but_not_mirrored() -> None:
    source = np.random.default_rng(3).normal(size=(6, 3))
    found = fit_similarity(source, source * [-1.0, 1.0, 1.0], with_scale=True)
    np.testing.assert_allclose(np.linalg.det(found.rotation), 1.0, atol=1e-12)
    assert np.abs(found.apply(source) - source * [-1.0, 1.0, 1.0]).max() > 0.1


def test_nan_frames_stay_nan_and_leave_the_others_alone() -> None:
    source = np.random.default_rng(4).normal(size=(3, 5, 3))
    target = source.copy()
    target[1, 2, 0] = np.nan
    found = fit_similarity(source, target, with_scale=True)
    assert np.isnan(found.scale).tolist() == [False, True, False]
    assert np.isnan(found.apply(source)[1]).all()
    np.testing.assert_allclose(found.apply(source)[[0, 2]], source[[0, 2]], atol=1e-12)


def test_coincident_points_have_no_scale() -> None:
    points = np.ones((4, 2))
    assert np.isnan(fit_similarity(points, points, with_scale=True).scale)
    np.testing.assert_array_equal(fit_similarity(points, points + 3.0, with_scale=False).apply(points), points + 3.0)
