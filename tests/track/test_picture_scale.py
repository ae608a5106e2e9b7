"""A hand that is small in the pictures of one camera is followed in larger ones."""

import pickle
from dataclasses import replace

import cv2
import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.runs import settings_of
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.track import FurtherPass, Tracker, TrackerState, View, restored_state, saved_state

SMALL = assumed_camera(160, 120)
FRAMES = 4


def tracker_of(camera: Camera, config: str = "contour_full") -> Tracker:
    settings = replace(settings_of(config), learned_proposals=False)
    return Tracker(load_hand_model().hand(side="right"), camera, settings)


@pytest.fixture(scope="module")
def pictures() -> list[torch.Tensor]:
    """A hand some 70 pixels long."""
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    motion = scripted_motion("planar", FRAMES, kinematics, SMALL, generator)
    return [frame.image for frame in render_sequence(kinematics, motion, SMALL, SceneSettings(), generator)]


@pytest.fixture(scope="module")
def first(pictures: list[torch.Tensor]) -> TrackerState:
    return tracker_of(SMALL).step(None, [View(image=pictures[0])], 0.0)[0]


def enlarged(image: torch.Tensor, scale: float) -> torch.Tensor:
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    return torch.from_numpy(cv2.resize(image.numpy(), size, interpolation=cv2.INTER_CUBIC))


def test_a_small_hand_is_followed_as_in_larger_pictures(pictures: list[torch.Tensor], first: TrackerState) -> None:
    """As by a tracker that is given these; what is told of it is in the pixels of the small ones."""
    scale = first.picture_scale
    assert 1.5 <= scale <= 3
    larger, small = tracker_of(SMALL.resized(scale)), tracker_of(SMALL)
    own, other = first, replace(first, picture_scale=1.0)
    for index, image in enumerate(pictures[1:], 1):
        own, found = small.step(own, [View(image=image)], index / 30)
        other, expected = larger.step(other, [View(image=enlarged(image, scale))], index / 30)
        assert own.picture_scale == scale
        assert found.status == expected.status == "tracked"
        assert found.pose is not None
        assert found.keypoints_px is not None
        assert expected.keypoints_px is not None
        torch.testing.assert_close(found.pose, expected.pose, atol=1e-6, rtol=0.0)
        torch.testing.assert_close((found.keypoints_px + 0.5) * scale - 0.5, expected.keypoints_px, atol=1e-3, rtol=0.0)


def test_a_tracker_can_be_sent_to_another_process(pictures: list[torch.Tensor], first: TrackerState) -> None:
    """Whatever sizes of pictures it has worked on."""
    views, tracker = [View(image=pictures[1])], tracker_of(SMALL)
    _, here = tracker.step(first, views, 1 / 30)
    _, there = pickle.loads(pickle.dumps(tracker)).step(first, views, 1 / 30)
    assert here.pose is not None
    assert torch.equal(here.pose, there.pose)


def test_a_state_is_of_its_pictures_wherever_it_goes_on(pictures: list[torch.Tensor], first: TrackerState) -> None:
    views = [View(image=pictures[1])]
    own, here = tracker_of(SMALL).step(first, views, 1 / 30)
    restored = restored_state(saved_state(first))
    _, there = tracker_of(SMALL).step(restored, views, 1 / 30)
    assert here.pose is not None
    assert there.pose is not None
    assert torch.equal(here.pose, there.pose)
    back = FurtherPass(tracker_of(SMALL), own).step(views, 1 / 30, here.pose).estimate
    assert back.keypoints_px is not None
    assert here.keypoints_px is not None
    assert float((back.keypoints_px - here.keypoints_px).norm(dim=-1).mean()) < 1.0


@pytest.mark.parametrize(("config", "width"), [("contour_full", 480), ("contour_planar", 160)])
def test_a_large_or_stiff_hand_is_followed_in_the_pictures_as_they_are(
    config: str, width: int, pictures: list[torch.Tensor]
) -> None:
    camera = SMALL.resized(width / 160)
    state, _ = tracker_of(camera, config).step(None, [View(image=enlarged(pictures[0], width / 160))], 0.0)
    assert state.has_started
    assert state.picture_scale == 1.0
