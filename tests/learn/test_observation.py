"""What the network sees does not depend on the camera."""

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.learn.observation import mirrored, observe

ALL = torch.ones(21, dtype=torch.bool)


def _hand(generator: torch.Generator, *batch: int) -> Tensor:
    """Keypoints of hands half a metre before the camera, any way round."""
    pose = torch.zeros(*batch, 36, dtype=torch.float64)
    pose[..., 3:6] = torch.randn(*batch, 3, generator=generator, dtype=torch.float64)
    pose[..., 6:] = 0.3 * torch.rand(*batch, 30, generator=generator, dtype=torch.float64)
    pose[..., 2] = 0.5
    return load_hand_model().kinematics(dtype=torch.float64)(pose).keypoints


def _plane(points: Tensor) -> Tensor:
    return points[..., :2] / points[..., 2:]


def test_turning_the_camera_changes_nothing(generator: torch.Generator) -> None:
    """Neither about the line of sight nor to the side: the view turns back what the camera was turned."""
    hand = _hand(generator)
    straight = observe(_plane(hand), ALL)
    for vector in ((0.0, 0.0, 2.5), (0.3, -0.2, 0.0), (-0.25, 0.4, -1.0)):
        turn = rotation_from_vector(torch.tensor(vector, dtype=torch.float64))
        turned = observe(_plane(hand @ turn.T), ALL)
        # The mean of the points in the picture, at which the view looks, moves a little over a picture that is turned.
        torch.testing.assert_close(turned.features, straight.features, atol=0.02, rtol=0)
        assert float((_plane(hand @ turn.T) - _plane(hand)).abs().max()) > 0.1
    roll = rotation_from_vector(torch.tensor((0.0, 0.0, 2.5), dtype=torch.float64))
    rolled = observe(_plane(hand @ roll.T), ALL)
    torch.testing.assert_close(rolled.features, straight.features, atol=1e-12, rtol=0)
    torch.testing.assert_close(rolled.cam_from_view, roll @ straight.cam_from_view, atol=1e-12, rtol=0)


def test_focal_length_and_resolution_change_nothing(generator: torch.Generator) -> None:
    hand = _hand(generator)
    pictures = (assumed_camera(640, 480), assumed_camera(300, 300, horizontal_fov_deg=30.0).resized(2.0))
    one, other = (observe(camera.plane_from_pixels(camera.project(hand)), ALL) for camera in pictures)
    torch.testing.assert_close(one.features, other.features, atol=1e-12, rtol=0)


def test_the_points_can_be_had_back(generator: torch.Generator) -> None:
    hand = _hand(generator)
    seen = observe(_plane(hand), ALL)
    points = seen.centre + seen.size * seen.features[:42].unflatten(0, (21, 2))
    view = torch.cat((points, torch.ones(21, 1, dtype=torch.float64)), -1)
    torch.testing.assert_close(_plane(view @ seen.cam_from_view.T), _plane(hand), atol=1e-12, rtol=0)
    torch.testing.assert_close(seen.cam_from_view @ seen.cam_from_view.T, torch.eye(3, dtype=torch.float64))
    assert float(torch.linalg.det(seen.cam_from_view)) == pytest.approx(1.0)
    knuckles = points[[5, 9, 13, 17]].mean(0) - points[0]
    assert float(knuckles[1]) < 0
    assert abs(float(knuckles[0])) < 1e-12
    assert float(seen.features[-1]) == pytest.approx(float(torch.log(seen.size / 0.1)))


@pytest.mark.parametrize("hidden", [[3], [0], [5, 9, 13, 17], [0, 7, 8, 20]])
def test_points_that_are_not_seen_do_not_matter(hidden: list[int], generator: torch.Generator) -> None:
    points = _plane(_hand(generator))
    seen = ALL.clone()
    seen[hidden] = False
    lost, elsewhere = points.clone(), points.clone()
    lost[hidden], elsewhere[hidden] = torch.nan, 3.0
    one, other = observe(lost, seen), observe(elsewhere, seen)
    assert torch.equal(one.features, other.features)
    assert bool(one.features.isfinite().all())
    features = one.features[:42].unflatten(0, (21, 2))
    assert bool((features[hidden] == 0).all())
    torch.testing.assert_close(one.features[42:63], seen.double())
    assert float(features.square().sum() / seen.sum()) == pytest.approx(1.0)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], generator: torch.Generator) -> None:
    points = _plane(_hand(generator, *batch))
    seen = torch.rand(*batch, 21, generator=generator) < 0.8
    whole = observe(points, seen)
    rows = zip(points.reshape(-1, 21, 2), seen.reshape(-1, 21), strict=True)
    for i, (some, flags) in enumerate(rows):
        alone = observe(some, flags)
        torch.testing.assert_close(whole.features.reshape(-1, 64)[i], alone.features, atol=1e-12, rtol=0)
        torch.testing.assert_close(whole.cam_from_view.reshape(-1, 3, 3)[i], alone.cam_from_view, atol=1e-12, rtol=0)


def test_a_mirrored_left_hand_is_a_right_hand(generator: torch.Generator) -> None:
    model = load_hand_model()
    right, left = (model.kinematics(side, dtype=torch.float64) for side in ("right", "left"))
    pose = torch.zeros(36, dtype=torch.float64)
    pose[2] = 0.5
    pose[6:] = 0.3 * torch.rand(30, generator=generator, dtype=torch.float64)
    # Hand frames whose z is the camera's x: mirrored in z there, mirrored in x here.
    upright = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)), dtype=torch.float64)
    one, other = (_plane(kinematics(pose, root_reference=upright).keypoints) for kinematics in (right, left))
    torch.testing.assert_close(mirrored(other), one, atol=1e-14, rtol=0)
