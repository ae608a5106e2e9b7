"""A run from pictures to records, on simulated sequences whose truth is known."""

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch

from tests.steps import saved_and_restored
from torchhand.evaluate import planar_motion_errors
from torchhand.files import FrameRecord, load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import DOFS, HandKinematics
from torchhand.runs import Run, settings_of
from torchhand.runs.recordings import RecordedFrame
from torchhand.runs.records import MEASURES, record_of
from torchhand.simulate import SceneSettings, background_picture, render_sequence, scripted_motion
from torchhand.track import Estimate, Tracker, TrackerSettings, TrackerState, View

WIDTH, HEIGHT, FPS = 240, 192, 30.0


@dataclass(frozen=True)
class Scene:
    frames: list[RecordedFrame]
    keypoints_px: np.ndarray
    fraction_in_view: np.ndarray
    """Of the keypoints, per frame."""


@dataclass
class RecordingInMemory:
    """A recording in memory (`Recording`)."""

    frames: list[RecordedFrame]
    cameras: Sequence[Camera]
    name: str = "recording"
    source: str = "memory"
    fps: float = FPS
    notes: Sequence[str] = ()

    @property
    def count(self) -> int | None:
        return len(self.frames)

    @contextmanager
    def opened(self, done: int) -> Iterator[Iterator[RecordedFrame]]:
        yield iter(self.frames[done:])

    def warnings(self) -> Sequence[str]:
        return ()


def _frame(index: int, image: torch.Tensor | None, problem: str | None = None) -> RecordedFrame:
    return RecordedFrame(index=index, time_s=index / FPS, views=(View(image=image),), problems=(problem,))


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics(dtype=torch.float64)


@pytest.fixture(scope="module")
def camera() -> Camera:
    return replace(assumed_camera(WIDTH, HEIGHT, horizontal_fov_deg=48.0), is_assumed=False)


@pytest.fixture(scope="module")
def settings() -> TrackerSettings:
    return settings_of("contour_planar")


@pytest.fixture(scope="module")
def begin(camera: Camera, settings: TrackerSettings) -> Any:
    def begin(state: TrackerState | None = None) -> Run:
        tracker = Tracker(load_hand_model().hand(side="right", dtype=torch.float64), camera, settings)
        return Run(RecordingInMemory(frames=[], cameras=[camera]), tracker, {}, state=state)

    return begin


def _scene(script: str, frames: int, kinematics: HandKinematics, camera: Camera, *, seed: int = 3) -> Scene:
    generator = torch.Generator().manual_seed(seed)
    motion = scripted_motion(script, frames, kinematics, camera, generator)
    scene = SceneSettings(noise=3.0, supersampling=2)
    rendered = list(render_sequence(kinematics, motion, camera, scene, generator))
    points = torch.stack([frame.keypoints_px for frame in rendered]).numpy()
    inside = ((points >= 0) & (points <= np.array((WIDTH - 1, HEIGHT - 1)))).all(-1)
    return Scene(
        frames=[_frame(frame.index, frame.image) for frame in rendered],
        keypoints_px=points,
        fraction_in_view=inside.mean(-1),
    )


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
def tracked_planar(planar: Scene, begin: Any) -> list[tuple[FrameRecord, TrackerState]]:
    run, tracked = begin(), []
    for frame in planar.frames:
        found = run.step(frame)
        assert found.corrected == []
        assert run.state is not None
        tracked.append((found.record(), run.state))
    return tracked


def test_planar_motion_is_followed_to_a_fraction_of_a_pixel(planar: Scene, tracked_planar: Any) -> None:
    records = [record for record, _ in tracked_planar]
    assert [record.status for record in records] == ["tracked"] * 40
    assert [record.frame for record in records] == list(range(40))
    errors = planar_motion_errors(_keypoints_px(records), planar.keypoints_px)
    assert errors is not None
    assert math.sqrt(float(np.mean(errors.displacement_px[1:] ** 2))) < 1.0
    assert math.sqrt(float(np.mean(errors.rotation_deg[1:] ** 2))) < 0.7
    moved = np.linalg.norm(planar.keypoints_px - planar.keypoints_px[0], axis=-1).max()
    assert moved > 10.0  # there was something to follow
    assert min(record.measures["overlap"] for record in records) > 0.85


def test_two_trackers_in_two_threads_find_what_each_finds_alone(planar: Scene, tracked_planar: Any, begin: Any) -> None:
    def poses(run: Run) -> np.ndarray:
        torch.set_num_threads(1)  # a thread's own number, as in the run before
        return np.stack([run.step(frame).record().pose for frame in planar.frames[:6]])

    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(poses, [begin(), begin()]))
    expected = np.stack([record.pose for record, _ in tracked_planar[:6]])
    for own in found:
        np.testing.assert_array_equal(own, expected)


def test_records_hold_the_estimate(tracked_planar: Any, kinematics: HandKinematics, camera: Camera) -> None:
    record, state = tracked_planar[7]
    keypoints = kinematics(torch.tensor(record.pose), state.shape).keypoints  # the pose is absolute
    np.testing.assert_allclose(record.keypoints3d, keypoints.numpy(), rtol=0, atol=1e-9)
    np.testing.assert_allclose(record.keypoints2d, camera.project(keypoints).numpy(), rtol=0, atol=1e-7)
    free = [DOFS.index(name) for name in ("root_tx", "root_ty", "root_rz")]
    assert (record.pose_std[free] > 0).all()
    assert record.seconds > 0
    assert set(record.measures) == set(MEASURES)
    assert record.reason == ""


def test_a_run_that_goes_on_from_a_saved_state_gives_the_same_numbers(
    planar: Scene, tracked_planar: Any, begin: Any
) -> None:
    run = begin(saved_and_restored(tracked_planar[9][1]))
    for frame, (expected, _) in zip(planar.frames[10:16], tracked_planar[10:16], strict=True):
        record = run.step(frame).record()
        assert replace(record, seconds=0.0).as_json() == replace(expected, seconds=0.0).as_json()


def test_a_hand_that_leaves_is_lost_and_recovered_when_it_is_back(
    kinematics: HandKinematics, camera: Camera, begin: Any
) -> None:
    scene, run = _scene("leave", 60, kinematics, camera), begin()
    records = [run.step(frame).record() for frame in scene.frames]
    status = [record.status for record in records]
    gone = np.flatnonzero(scene.fraction_in_view == 0)
    first, last = int(gone[0]), int(gone[-1])
    back = int(np.flatnonzero((np.arange(60) > last) & (scene.fraction_in_view == 1))[0])
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


@pytest.mark.parametrize("background", ["plain", "dark", pytest.param("clutter", marks=pytest.mark.slow)])
def test_without_a_hand_there_is_none(background: str, begin: Any) -> None:
    generator = torch.Generator().manual_seed(0)
    behind = background_picture(background, WIDTH, HEIGHT, generator)  # pyright: ignore[reportArgumentType]
    run = begin()
    for index in range(2):
        noisy = behind + 3.0 * torch.randn(HEIGHT, WIDTH, 3, generator=generator)
        record = run.step(_frame(index, noisy.round().clamp(0, 255).to(torch.uint8))).record()
        assert record.status == "no_hand"
        assert record.reason
        _assert_empty(record)


def test_a_frame_that_cannot_be_read_is_no_hand_and_the_track_goes_on(planar: Scene, begin: Any) -> None:
    frames, run = list(planar.frames[:6]), begin()
    for index in (0, 3):
        frames[index] = _frame(index, None, f"{index}.png: is a truncated JPEG file")
    records = [run.step(frame).record() for frame in frames]
    assert [record.status for record in records] == ["no_hand", "tracked", "tracked", "no_hand", "tracked", "tracked"]
    assert "3.png: is a truncated JPEG file" in records[3].reason
    _assert_empty(records[3])
    off = np.linalg.norm(_keypoints_px(records[4:]) - planar.keypoints_px[4:6], axis=-1)
    assert off.mean() < 3.0


def test_numbers_of_a_frame_that_is_lost() -> None:
    estimate = Estimate(status="lost", time_s=0.1, reason="edges on 3%")
    record = record_of(4, estimate, ("camera",), seconds=0.25)
    assert (record.frame, record.status, record.seconds, record.reason) == (4, "lost", 0.25, "edges on 3%")
    assert all(math.isnan(value) for value in record.measures.values())
    _assert_empty(record)


def test_every_view_of_a_rig_has_its_own_overlap() -> None:
    names = ("left", "right")
    estimate = Estimate(status="lost", time_s=0.1, reason="nothing there")
    record = record_of(0, estimate, names, seconds=0.0, problems="left: gone")
    assert record.keypoints2d is None
    assert set(record.measures) == {*MEASURES, "views", "overlap_left", "overlap_right"}
    assert record.reason == "nothing there; left: gone"
