"""Axis, ends and widths of drawn fingers to a fraction of a pixel."""

import numpy as np
import pytest

from torchhand.image.fingers.profile import finger_profile, sampled


def finger(tip: np.ndarray, angle: float, radius: float, length: float) -> np.ndarray:
    """An antialiased capsule whose outermost point is `tip`, pointing along `angle`; its other end lies far off."""
    y, x = np.mgrid[:160, :160].astype(float)
    direction = np.array((np.cos(angle), np.sin(angle)))
    centre = tip - radius * direction
    along = np.clip((x - centre[0]) * direction[0] + (y - centre[1]) * direction[1], -length, 0.0)
    distance = np.hypot(x - centre[0] - along * direction[0], y - centre[1] - along * direction[1])
    return np.clip(0.5 + radius - distance, 0.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("angle", [0.0, 0.7, -1.9, 2.6])
def test_ends_axis_and_width(angle: float) -> None:
    tip = np.array((80.3, 79.6)) + 30 * np.array((np.cos(angle), np.sin(angle)))
    plane = finger(tip, angle, 8.25, 90.0)
    direction = np.array((np.cos(angle), np.sin(angle)))
    rough = tip + np.array((1.5, -1.0)), tip - 55 * direction + np.array((-2.0, 1.0))
    found = finger_profile(plane, tuple(rough[0]), tuple(rough[1]), 16.0)
    assert found is not None
    assert np.hypot(*(found.tip - tip)) < 0.15
    assert found.direction @ direction > np.cos(0.01)
    shaft = (found.along > 12) & (found.along < 45)
    # bilinear reading of an edge averaged over pixels is off by up to 1/16 px on either side
    assert float(np.median(found.width[shaft])) == pytest.approx(16.5, abs=0.13)
    assert found.straightness < 0.01


def test_nothing_where_there_is_no_finger() -> None:
    assert finger_profile(np.zeros((50, 50), np.float32), (10.0, 10.0), (10.0, 40.0), 8.0) is None
    assert finger_profile(np.ones((50, 50), np.float32), (10.0, 10.0), (10.0, 11.0), 8.0) is None


def test_sampled_is_bilinear_and_zero_outside() -> None:
    plane = np.arange(12, dtype=np.float32).reshape(3, 4)
    values = sampled(plane, np.array(((1.5, 1.0), (2.0, 0.5), (-5.0, 1.0))))
    assert values.tolist() == pytest.approx([5.5, 4.0, 0.0])
