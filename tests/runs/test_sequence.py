"""The contour tracker from pictures to records, on simulated sequences whose truth is known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from torchhand.evaluate import planar_motion_errors
from torchhand.files import Frame, FrameRecord, find_config, load_hand_model, load_settings
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import DOFS, HandKinematics
from torchhand.runs.sequence import MEASURES, TrackedFrame, follow, record_of
from torchhand.simulate import SceneSettings, background_picture, render_sequence, scripted_motion
from torchhand.track import ContourTrackerSettings, Estimate
from torchhand.track.unscented import ContourTracker

WIDTH, HEIGHT = 240, 192


@dataclass(frozen=True)
class Scene:
    frames: list[Frame]
    keypoints_px: np.ndarray
    share_in_view: np.ndarray
    """Of the keypoints, per frame."""


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics(dtype=torch.float64)


@pytest.fixture(scope="module")
def camera() -> Camera:
    return replace(assumed_camera(WIDTH, HEIGHT, horizontal_fov_deg=48.0), is_assumed=False)


@pytest.fixture(scope="module")
def settings() -> ContourTrackerSettings:
    return load_settings(ContourTrackerSettings(), find_config("contour_planar"))


def _scene(script: str, frames: int, kinematics: HandKinematics, camera: Camera, *, seed: int = 3) -> Scene:
    generator = torch.Generator().manual_seed(seed)
    motion = scripted_motion(script, frames, kinematics, camera, generator)
    look = SceneSettings(noise=3.0, supersampling=2)
    rendered = list(render_sequence(kinematics, motion, camera, look, generator))
    points = torch.stack([frame.keypoints_px for frame in rendered]).numpy()
    inside = ((points >= 0) & (points <= np.array((WIDTH - 1, HEIGHT - 1)))).all(-1)
    return Scene(
        frames=[Frame(index=frame.index, image=frame.image) for frame in rendered],
        keypoints_px=points,
        share_in_view=inside.mean(-1),
    )


def _records(tracked: Sequence[TrackedFrame]) -> list[FrameRecord]:
    return [one.record for one in tracked]


def _keypoints_px(records: Sequence[FrameRecord]) -> np.ndarray:
    arrays = [record.keypoints2d for record in records]
    assert all(array is not None for array in arrays)
    return np.stack([array for array in arrays if array is not None])


def _assert_empty(record: FrameRecord) -> None:
    for name in ("pose", "pose_std", "keypoints3d", "keypoints2d", "keypoints3d_cov"):
        assert np.isnan(getattr(record, name)).all(), name


@pytest.fixture(scope="module")
def planar(kinematics: HandKinematics, camera: Camera) -> Scene:
    return _scene("planar", 40, kinematics, camera)


@pytest.fixture(scope="module")
def tracked_planar(
    planar: Scene, kinematics: HandKinematics, camera: Camera, settings: ContourTrackerSettings
) -> list[TrackedFrame]:
    return list(follow(ContourTracker(kinematics, camera, 30.0, settings), planar.frames))


def test_planar_motion_is_followed_to_a_fraction_of_a_pixel(planar: Scene, tracked_planar: list[TrackedFrame]) -> None:
    records = _records(tracked_planar)
    assert [record.status for record in records] == ["tracked"] * 40
    assert [record.frame for record in records] == list(range(40))
    errors = planar_motion_errors(_keypoints_px(records), planar.keypoints_px)
    assert errors is not None
    assert math.sqrt(float(np.mean(errors.displacement_px[1:] ** 2))) < 1.0
    assert math.sqrt(float(np.mean(errors.rotation_deg[1:] ** 2))) < 0.7
    moved = np.linalg.norm(planar.keypoints_px - planar.keypoints_px[0], axis=-1).max()
    assert moved > 10.0  # there was something to follow
    overlaps = [record.measures["overlap"] for record in records]
    assert min(overlaps) > 0.85


def test_records_hold_the_estimate(
    tracked_planar: list[TrackedFrame], kinematics: HandKinematics, camera: Camera
) -> None:
    record, memory = tracked_planar[7].record, tracked_planar[7].memory
    assert memory.shape is not None
    keypoints = kinematics(torch.tensor(record.pose), memory.shape).keypoints  # the pose is absolute
    np.testing.assert_allclose(record.keypoints3d, keypoints.numpy(), rtol=0, atol=1e-9)
    assert record.keypoints2d is not None
    np.testing.assert_allclose(record.keypoints2d, camera.project(keypoints).numpy(), rtol=0, atol=1e-7)
    free = [DOFS.index(name) for name in ("root_tx", "root_ty", "root_rz")]
    assert (record.pose_std[free] > 0).all()
    assert record.seconds > 0
    assert set(record.measures) == set(MEASURES)
    assert record.reason == ""


def test_a_run_that_goes_on_from_a_saved_state_gives_the_same_numbers(
    planar: Scene,
    tracked_planar: list[TrackedFrame],
    kinematics: HandKinematics,
    camera: Camera,
    settings: ContourTrackerSettings,
) -> None:
    tracker = ContourTracker(kinematics, camera, 30.0, settings)
    saved = tracker.state_dict(tracked_planar[9].state, tracked_planar[9].memory)
    again = list(follow(tracker, planar.frames[10:16], *tracker.restore(saved)))
    for one, other in zip(_records(again), _records(tracked_planar[10:16]), strict=True):
        assert replace(one, seconds=0.0).as_json() == replace(other, seconds=0.0).as_json()


def test_a_hand_that_leaves_is_lost_and_recovered_when_it_is_back(
    kinematics: HandKinematics, camera: Camera, settings: ContourTrackerSettings
) -> None:
    scene = _scene("leave", 60, kinematics, camera)
    records = _records(list(follow(ContourTracker(kinematics, camera, 30.0, settings), scene.frames)))
    status = [record.status for record in records]
    gone = np.flatnonzero(scene.share_in_view == 0)
    first, last = int(gone[0]), int(gone[-1])
    back = int(np.flatnonzero((np.arange(60) > last) & (scene.share_in_view == 1))[0])
    assert first > 5
    assert last > first + 6
    assert set(status[:5]) == {"tracked"}
    assert set(status[first + 5 : last + 1]) <= {"lost", "no_hand"}
    for record in records[first + 5 : last + 1]:
        _assert_empty(record)
        assert record.reason
    followed = {"tracked", "recovered"}
    recovered = next(i for i in range(last + 1, 60) if status[i] in followed)
    assert status[recovered] == "recovered"
    assert recovered <= back + 15
    assert set(status[back + 15 :]) <= followed
    off = np.linalg.norm(_keypoints_px(records[-3:]) - scene.keypoints_px[-3:], axis=-1)
    assert off.mean() < 3.0


@pytest.mark.parametrize("background", ["plain", "dark", "clutter"])
def test_without_a_hand_there_is_none(
    background: str, kinematics: HandKinematics, camera: Camera, settings: ContourTrackerSettings
) -> None:
    generator = torch.Generator().manual_seed(0)
    behind = background_picture(background, WIDTH, HEIGHT, generator)  # pyright: ignore[reportArgumentType]
    noise = [(3.0 * torch.randn(HEIGHT, WIDTH, 3, generator=generator)) for _ in range(3)]
    images = [(behind + one).round().clamp(0, 255).to(torch.uint8) for one in noise]
    frames = [Frame(index=i, image=image) for i, image in enumerate(images)]
    for record in _records(list(follow(ContourTracker(kinematics, camera, 30.0, settings), frames))):
        assert record.status == "no_hand"
        assert record.reason
        _assert_empty(record)


def test_a_frame_that_cannot_be_read_is_no_hand_and_the_track_goes_on(
    planar: Scene, kinematics: HandKinematics, camera: Camera, settings: ContourTrackerSettings
) -> None:
    frames = list(planar.frames[:6])
    frames[0] = Frame(index=0, image=None, problem="0.png: is a truncated JPEG file")
    frames[3] = Frame(index=3, image=None, problem="3.png: is a truncated JPEG file")
    tracked = list(follow(ContourTracker(kinematics, camera, 30.0, settings), frames))
    records = _records(tracked)
    assert [record.status for record in records] == ["no_hand", "tracked", "tracked", "no_hand", "tracked", "tracked"]
    assert records[3].reason == "3.png: is a truncated JPEG file"
    assert records[3].seconds == 0.0
    _assert_empty(records[3])
    assert tracked[0].memory.shape is None
    off = np.linalg.norm(_keypoints_px(records[4:]) - planar.keypoints_px[4:6], axis=-1)
    assert off.mean() < 3.0


def test_frames_are_tracked_one_by_one(
    planar: Scene, kinematics: HandKinematics, camera: Camera, settings: ContourTrackerSettings
) -> None:
    asked: list[int] = []

    def source():
        for frame in planar.frames:
            asked.append(frame.index)
            yield frame

    tracked = follow(ContourTracker(kinematics, camera, 30.0, settings), source())
    assert next(tracked).record.frame == 0
    assert next(tracked).record.frame == 1
    assert asked == [0, 1]


def test_numbers_of_a_frame_that_is_lost() -> None:
    record = record_of(4, Estimate(status="lost", reason="edges on 3%"), seconds=0.25)
    assert (record.frame, record.status, record.seconds, record.reason) == (4, "lost", 0.25, "edges on 3%")
    assert all(math.isnan(value) for value in record.measures.values())
    _assert_empty(record)
