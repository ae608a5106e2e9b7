"""Large pictures are worked on at a bounded size, and nobody who gives views or reads results sees that."""

from dataclasses import replace

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.image import BackgroundPlate
from torchhand.runs import settings_of
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.track import Estimate, HandKeypoints, Tracker, View
from torchhand.track.scene import WorkingViews

LARGE = assumed_camera(800, 600)


def test_small_pictures_stay_as_they_are() -> None:
    view = View(image=torch.zeros(600, 800, 3, dtype=torch.uint8))
    working = WorkingViews((LARGE,), 800 * 600)
    assert working.cameras == (LARGE,)
    assert working.of(view, 0, LARGE) is view


@pytest.mark.parametrize("distortion", [(0.0, 0.0, 0.0, 0.0), (-0.1, 0.02, 0.0, 0.0)])
def test_a_point_of_space_is_where_the_reduced_camera_says(distortion: tuple[float, ...]) -> None:
    given = replace(LARGE, distortion=torch.tensor(distortion, dtype=torch.float64))
    working = WorkingViews((given,), 400 * 300)
    (used,) = working.cameras
    assert (used.width, used.height) == (400, 300)
    point = torch.tensor([[0.05, -0.03, 0.5]], dtype=torch.float64)
    seen = given.project(point).expand(21, 2)
    view = View(keypoints=HandKeypoints(points_px=seen))
    for sees in (used, replace(used, distortion=torch.zeros(4, dtype=torch.float64))):
        own = working.of(view, 0, sees)
        assert own.keypoints is not None
        torch.testing.assert_close(own.keypoints.points_px, sees.project(point).expand(21, 2), atol=1e-6, rtol=0.0)
        assert working.of(view, 0, sees) is own
    torch.testing.assert_close(working.whole_px(used.project(point), 0), given.project(point))
    start = tuple(given.project(point)[0].tolist()) * 2
    assert working.points((start[0], start[1], start[2], start[3])) == pytest.approx(
        tuple(used.project(point)[0].tolist()) * 2
    )


@pytest.mark.parametrize(("max_pixels", "size"), [(10**7, (1600, 1200)), (800 * 600 * 9 // 4, (1200, 900))])
def test_pictures_are_enlarged_as_far_as_wanted_and_allowed(max_pixels: int, size: tuple[int, int]) -> None:
    working = WorkingViews((LARGE,), max_pixels, scale=2.0)
    (used,) = working.cameras
    assert (used.width, used.height) == size
    point = torch.tensor([[0.05, -0.03, 0.5]], dtype=torch.float64)
    torch.testing.assert_close(working.whole_px(used.project(point), 0), LARGE.project(point))
    image, mask = torch.zeros(600, 800, 3, dtype=torch.uint8), torch.zeros(600, 800, dtype=torch.bool)
    image[200:400, 300:500], mask[200:400, 300:500] = 200, True
    own = working.of(View(image=image, mask=mask), 0, used)
    assert own.image is not None
    assert own.mask is not None
    scale = size[0] / 800
    assert int(own.mask.sum()) == pytest.approx(200 * 200 * scale**2, rel=0.01)
    assert float((own.image[..., 0] > 100).double().mean()) == pytest.approx(200 * 200 / 800 / 600, rel=0.01)


def test_plates_are_reduced_with_the_pictures(generator: torch.Generator) -> None:
    colour = torch.randint(0, 255, (600, 800, 3), generator=generator).to(torch.uint8)
    plate = BackgroundPlate(colour=colour, noise=torch.full((600, 800, 3), 2.6))
    plates = WorkingViews((LARGE,), 400 * 300).plates([plate])
    assert plates is not None
    assert plates[0].colour.shape == (300, 400, 3)
    torch.testing.assert_close(plates[0].noise, torch.full((300, 400, 3), 2.6))


def _tracked(camera: Camera, images: list[torch.Tensor], max_pixels: int) -> tuple[Tracker, list[Estimate]]:
    settings = replace(settings_of("contour_planar"), max_pixels=max_pixels)
    tracker, state, found = Tracker(load_hand_model().hand(side="right"), camera, settings), None, []
    for index, image in enumerate(images):
        state, estimate = tracker.step(state, [View(image=image)], index / 30)
        found.append(estimate)
    return tracker, found


def test_results_are_in_the_pixels_of_the_picture() -> None:
    """A hand that is followed in pictures of four times as many pixels is where it is in all of them."""
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    camera = assumed_camera(320, 240)
    generator = torch.Generator().manual_seed(0)
    motion = scripted_motion("planar", 3, kinematics, camera, generator)
    small = [frame.image for frame in render_sequence(kinematics, motion, camera, SceneSettings(), generator)]
    large = [image.repeat_interleave(2, 0).repeat_interleave(2, 1) for image in small]
    big = camera.resized(2.0)
    _, expected = _tracked(camera, small, 10**7)
    tracker, found = _tracked(big, large, 320 * 240)
    assert tracker.own_cameras[0].width == 640
    for one, other in zip(found, expected, strict=True):
        assert one.status == other.status == "tracked"
        assert one.pose is not None
        assert other.pose is not None
        torch.testing.assert_close(one.pose, other.pose, atol=1e-6, rtol=0.0)
        assert one.keypoints_px is not None
        assert other.keypoints_px is not None
        torch.testing.assert_close(one.keypoints_px, (other.keypoints_px + 0.5) * 2 - 0.5, atol=1e-3, rtol=0.0)
