"""Trackers, and hands in single pictures, on a device: what the processor finds, and nothing of the processor's among
what is computed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.fit.hull.conftest import Rig, make_rig
from tests.steps import FRAME_S
from torchhand.files import load_hand_model
from torchhand.fit.hull import HullStartSettings
from torchhand.fit.open_hand import OpenHand, fit_open_hand
from torchhand.hand import HandPose
from torchhand.runs import settings_of
from torchhand.runs.pictures import single_pose_fitter
from torchhand.track import (
    Estimate,
    FollowedFrame,
    FurtherPass,
    Keyframe,
    Tracker,
    TrackerState,
    View,
    recorded_shape,
    restored_state,
    saved_state,
)
from torchhand.track.single import SinglePoseSettings

MODEL = load_hand_model()
CPU = torch.device("cpu")
ATOL = 1e-5
"""Radians and metres: pictures are smoothed by OpenCV on the processor and by kornia elsewhere, in single precision."""


@pytest.fixture(scope="module")
def film(studio: Any) -> Any:
    return studio.film("planar", 3, total=14, pace=3.0)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return make_rig()


def tracker_of(film: Any, device: torch.device, config: str) -> Tracker:
    hand = MODEL.to(device=device).hand(dtype=torch.float64)
    return Tracker(hand, film.camera, settings_of(config))


def followed(tracker: Tracker, images: Sequence[Tensor]) -> tuple[TrackerState, list[Estimate]]:
    state: TrackerState | None = None
    found = []
    for index, image in enumerate(images):
        state, estimate = tracker.step(state, [View(image=image)], index * FRAME_S)
        found.append(estimate)
    assert state is not None
    return state, found


def same(found: Estimate, expected: Estimate) -> None:
    assert found.status == expected.status == "tracked"
    for name in ("pose", "pose_std", "keypoints", "keypoints_cov", "finger_quality"):
        own, other = getattr(found, name), getattr(expected, name)
        assert own.device == CPU
        torch.testing.assert_close(own, other, rtol=0, atol=ATOL)
    torch.testing.assert_close(found.keypoints_px, expected.keypoints_px, rtol=0, atol=1e-3)
    assert found.score == pytest.approx(expected.score, abs=1e-5)


@pytest.mark.parametrize(
    "config",
    ["contour_planar", *(pytest.param(name, marks=pytest.mark.slow) for name in ("contour_full", "distance_full"))],
)
def test_a_hand_is_followed_on_a_device_as_on_the_processor(config: str, device: torch.device, film: Any) -> None:
    _, expected = followed(tracker_of(film, CPU, config), film.images[:2])
    tracker = tracker_of(film, device, config)
    state, found = followed(tracker, film.images[:2])
    assert state.hand is not None
    assert state.hand.belief.mean.device.type == device.type
    for one, other in zip(found, expected, strict=True):
        same(one, other)


def test_a_state_goes_on_where_another_device_left_it(device: torch.device, film: Any) -> None:
    """Saved from the processor, restored on the device, and back again."""
    there, here = (tracker_of(film, where, "contour_planar") for where in (device, CPU))
    state, _ = followed(here, film.images[:1])
    views, time_s = [View(image=film.images[1])], FRAME_S
    moved = restored_state(saved_state(state), there.device)
    assert moved.hand is not None
    assert moved.hand.base.device.type == device.type
    after, found = there.step(moved, views, time_s)
    _, expected = here.step(state, views, time_s)
    same(found, expected)
    saved = restored_state(saved_state(after))
    assert saved.hand is not None
    assert saved.hand.base.device == CPU


@pytest.mark.slow
def test_the_second_pass_and_its_proportions(device: torch.device, film: Any) -> None:
    def worked(where: torch.device) -> tuple[Tensor, Estimate]:
        tracker = tracker_of(film, where, "contour_full")
        state, found = followed(tracker, film.images)
        frames = [
            FollowedFrame(views=(View(image=image),), time_s=one.time_s, pose=one.pose)
            for image, one in zip(film.images, found, strict=True)
            if one.pose is not None
        ]
        fitted = recorded_shape(tracker, state, [*frames, *frames])
        assert fitted is not None
        back = FurtherPass(tracker, state, fitted=fitted)
        for image, one in zip(reversed(film.images), reversed(found), strict=True):
            second = back.step([View(image=image)], one.time_s, one.pose)
        return fitted.shape.to(CPU), second.estimate

    (shape, found), (expected_shape, expected) = worked(device), worked(CPU)
    torch.testing.assert_close(shape, expected_shape, rtol=0, atol=ATOL)
    same(found, expected)


@pytest.mark.slow
def test_hulls_are_followed_and_their_hand_is_fitted(device: torch.device, rig: Rig) -> None:
    start = HullStartSettings(places=1, rolls=4, postures=("open",), coarse=6, fine=2, finger_rounds=0)
    settings = settings_of("hull_lm")
    settings = replace(settings, rig=replace(settings.rig, start=start))
    pose, _ = rig.person(3)
    views = [View(mask=mask) for mask in rig.masks(pose)]
    off = rig.moved(pose, 1, deg=3, mm=4).normalized()

    def worked(where: torch.device) -> tuple[TrackerState, Estimate]:
        hand = MODEL.to(device=where).hand(dtype=torch.float64)
        tracker = Tracker(hand, rig.cameras, settings)
        known = HandPose(dofs=off.dofs.to(where), reference=off.reference.to(where))
        state = TrackerState(
            shape=hand.kinematics.default_shape, keyframes=(Keyframe(time_s=0.0, pose=known),), shape_frames=()
        )
        return tracker.step(state, views, 0.0)

    (state, found), (expected_state, expected) = worked(device), worked(CPU)
    same(found, expected)
    assert state.shape is not None
    assert expected_state.shape is not None
    assert not torch.equal(expected_state.shape, MODEL.kinematics(dtype=torch.float64).default_shape)  # it was fitted
    torch.testing.assert_close(state.shape.to(CPU), expected_state.shape, rtol=0, atol=ATOL)


def test_one_tensor_of_the_processor_is_found(device: torch.device, film: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is made without a device where all else has one fails, as it would on CUDA."""
    told = "torchhand.track.belief.motion.HandMotion._told"
    monkeypatch.setattr(told, lambda self, values: torch.tensor(values, dtype=torch.float64))
    with pytest.raises(RuntimeError, match="device"):
        followed(tracker_of(film, device, "contour_planar"), film.images[:1])


def test_proportions_of_an_open_hand(device: torch.device, studio: Any) -> None:
    placed = studio.placed(camera=studio.camera(320, 256), size=0.7)

    def worked(where: torch.device) -> OpenHand:
        found = fit_open_hand(
            placed.mask, MODEL.to(device=where).kinematics("right", dtype=torch.float64), placed.camera
        )
        assert isinstance(found, OpenHand)
        return found

    found, expected = worked(device), worked(CPU)
    for name in ("pose", "shape", "pose_std", "shape_std"):
        torch.testing.assert_close(getattr(found.fit, name), getattr(expected.fit, name), rtol=0, atol=ATOL)
    assert found.overlap == pytest.approx(expected.overlap, abs=1e-3)
    assert found.corrected == expected.corrected


@pytest.mark.slow
def test_the_hand_of_a_single_picture(device: torch.device, studio: Any) -> None:
    placed = studio.placed(posed="open", camera=studio.camera(160, 128))
    view = View(image=placed.picture(), mask=placed.mask)
    settings = SinglePoseSettings()
    found, expected = (single_pose_fitter("right", settings, where)(view, placed.camera) for where in (device, CPU))
    same(found.estimate, expected.estimate)
    torch.testing.assert_close(found.shape, expected.shape, rtol=0, atol=ATOL)
