"""Metric size: what scales with it, what does not, and how sure it is."""

from dataclasses import replace

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.fit.detect import Fit, facing_rotation
from torchhand.fit.open_hand.hand_size import known_length, length_at_distance, population_length, sized
from torchhand.geometry import assumed_camera
from torchhand.hand import posture

MODEL = load_hand_model()
SPACE = MODEL.shape_space
KINEMATICS = MODEL.kinematics("right", dtype=torch.float64)
CAMERA = assumed_camera(640, 480)


def placed() -> Fit:
    pose = posture("open", dtype=torch.float64)
    pose[:3] = torch.tensor((0.02, -0.01, 0.5))
    fit = Fit.of_start(pose, facing_rotation("back"), SPACE.default.clone())
    pose_std = torch.zeros(36, dtype=torch.float64)
    pose_std[2] = 0.01
    return replace(fit, shape_std=0.1 * SPACE.std, pose_std=pose_std)


@pytest.mark.parametrize("length", [0.16, 0.187, 0.21])
def test_picture_stays_and_ratios_stay(length: float) -> None:
    before = placed()
    after = sized(before, SPACE, known_length(length))

    def picture(fit: Fit) -> torch.Tensor:
        return CAMERA.project(KINEMATICS(fit.pose, fit.shape, root_reference=fit.root_reference).keypoints)

    assert float((picture(after) - picture(before)).abs().max()) < 1e-9
    assert float(after.shape[0]) == pytest.approx(length)
    assert bool((after.shape[2:] == before.shape[2:]).all())
    assert float(after.shape_std[0]) == pytest.approx(0.001)


def test_distance_tells_the_length() -> None:
    fit = placed()
    points = KINEMATICS(fit.pose, fit.shape, root_reference=fit.root_reference).keypoints
    depth = float(0.5 * (points[0, 2] + points[9, 2]))
    size = length_at_distance(fit, KINEMATICS, CAMERA, 1.1 * depth)
    assert size.length == pytest.approx(1.1 * 0.187)
    assert size.std == pytest.approx(size.length * 0.01 / depth)
    assert size.source == "camera and distance"
    with pytest.raises(ValueError, match="pinhole"):
        length_at_distance(fit, KINEMATICS, replace(CAMERA, kind="orthographic"), 0.5)


def test_population_spread_reaches_length_breadth_and_depth() -> None:
    fit = placed()
    after = sized(fit, SPACE, population_length(SPACE))
    fraction = 0.0115 / 0.187
    assert float(after.shape_std[0]) == pytest.approx(0.0115)
    breadth = SPACE.names.index("hand_breadth")
    expected = ((0.083 * fraction) ** 2 + float(fit.shape_std[breadth]) ** 2) ** 0.5
    assert float(after.shape_std[breadth]) == pytest.approx(expected)
    assert float(after.pose_std[2]) == pytest.approx(((0.5 * fraction) ** 2 + 0.01**2) ** 0.5)


def test_breadth_stays_within_bounds() -> None:
    wide = placed()
    shape = wide.shape.clone()
    shape[SPACE.names.index("hand_breadth")] = 0.1
    after = sized(replace(wide, shape=shape), SPACE, known_length(0.24))
    assert float(after.shape[SPACE.names.index("hand_breadth")]) == pytest.approx(0.108)
