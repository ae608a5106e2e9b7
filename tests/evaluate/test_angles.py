"""Flexion read from keypoints: hand-made fingers, and the definition that the truth files use."""

from pathlib import Path

import numpy as np
import pytest

from torchhand.evaluate.angles import (
    flexion_deg,
    proximal_turns_deg,
    proximal_turns_in_space_deg,
    without_offset,
    wrapped_deg,
)
from torchhand.hand import FINGER_CHAINS


def finger(angles_deg: list[float]) -> np.ndarray:
    """A planar chain of four unit bones whose direction turns by the given angles."""
    direction = np.radians(np.cumsum([0.0, *angles_deg]))
    bones = np.stack([np.cos(direction), np.sin(direction), np.zeros(4)], axis=-1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(bones, axis=0)])


def test_known_angles_come_back_finger_by_finger() -> None:
    angles = np.array([[10.0, 20, 30], [0, 0, 0], [90, 100, 45], [1e-5, 179, 5], [60, 0, 90]])
    keypoints = np.zeros((21, 3))
    for chain, values in zip(FINGER_CHAINS, angles, strict=True):
        keypoints[list(chain)] = finger(values.tolist())
    np.testing.assert_allclose(flexion_deg(keypoints), angles, atol=1e-10)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...]) -> None:
    keypoints = np.random.default_rng(0).normal(size=(*batch, 21, 3))
    together = flexion_deg(keypoints)
    assert together.shape == (*batch, 5, 3)
    for index in np.ndindex(*batch):
        np.testing.assert_array_equal(together[index], flexion_deg(keypoints[index]))


def test_a_bone_without_length_has_no_angle() -> None:
    keypoints = np.random.default_rng(0).normal(size=(21, 3))
    keypoints[8] = keypoints[7]
    unknown = np.isnan(flexion_deg(keypoints))
    assert np.argwhere(unknown).tolist() == [[1, 2]]


@pytest.mark.parametrize("name", ["free", "flexion", "mv_motion"])
def test_the_definition_is_that_of_the_truth_files(data_dir: Path, name: str) -> None:
    with np.load(data_dir / "synthetic" / name / "truth.npz") as truth:
        np.testing.assert_allclose(flexion_deg(truth["keypoints3d"]), truth["flexion_deg"], rtol=0, atol=1e-9)


def test_only_a_constant_is_removed_and_lost_frames_do_not_count() -> None:
    wobble = np.array([[1.0, 4.0], [-1.0, np.nan], [np.nan, np.nan]])
    np.testing.assert_allclose(
        without_offset(wobble + [7.0, 0.0]), [[1.0, np.nan], [-1.0, np.nan], [np.nan, np.nan]], atol=1e-15
    )


def test_proximal_phalanges_turn_since_the_reference_frame() -> None:
    turns = np.array([[5.0, -10, 170, 30, 0], [0, 0, 0, 0, 0], [-175, 20, 185, -90, 1]])
    points = np.random.default_rng(1).normal(size=(3, 21, 2))
    start = np.radians(np.array([10.0, 80, 179, -120, 0]))
    for finger, base in enumerate((2, 5, 9, 13, 17)):
        angle = start[finger] + np.radians(turns[:, finger])
        points[:, base + 1] = points[:, base] + 3.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    np.testing.assert_allclose(proximal_turns_deg(points, 1), wrapped_deg(turns), atol=1e-10)
    assert wrapped_deg(np.array([185.0, -180, 180, 540])).tolist() == [-175, 180, 180, 180]


def test_turns_in_space_are_those_of_each_proximal_phalanx_about_any_axis() -> None:
    generator = np.random.default_rng(5)
    points = generator.normal(size=(1, 21, 3)).repeat(3, 0)
    bone = points[0, 6] - points[0, 5]
    axis = np.cross(bone, generator.normal(size=3))
    axis /= np.linalg.norm(axis)
    for frame, angle in ((1, np.radians(10.0)), (2, np.radians(75.0))):
        turned = bone * np.cos(angle) + np.cross(axis, bone) * np.sin(angle)
        points[frame, 6] = points[frame, 5] + 2.0 * turned  # a longer bone turns as far
    expected = np.zeros((3, 5))
    expected[:, 1] = 0.0, 10.0, 75.0
    np.testing.assert_allclose(proximal_turns_in_space_deg(points, 0), expected, atol=1e-6)
