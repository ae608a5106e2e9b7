"""Detections of files beside the pictures of a recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import save_cameras, write_video
from torchhand.geometry import assumed_camera
from torchhand.runs.keypoint_tracks import KeypointTracks, with_keypoints
from torchhand.runs.recordings import RecordedFrame, RigRecording
from torchhand.track import View

WIDTH, HEIGHT = 40, 30


def test_frames_of_several_cameras_have_the_times_and_the_keypoints_of_their_pictures(tmp_path: Path) -> None:
    """25 frames a second beside 10: the frames of the slow camera, and of the fast one the keypoints of the pictures
    that were taken then; wherever reading starts."""
    one = assumed_camera(WIDTH, HEIGHT)
    save_cameras([replace(one, name="fast"), replace(one, name="slow")], tmp_path / "cameras.json")
    files = []
    for name, fps, count in (("fast", 25.0, 26), ("slow", 10.0, 11)):
        with write_video(tmp_path / f"{name}.mp4", width=WIDTH, height=HEIGHT, fps=fps) as video:
            for number in range(count):
                video.write(torch.full((HEIGHT, WIDTH, 3), 40 + 3 * number, dtype=torch.uint8))
        points = np.broadcast_to(np.arange(1.0, count + 1)[:, None, None], (count, 21, 2))
        files.append(tmp_path / f"{name}.npz")
        np.savez(files[-1], points_px=points, label=np.full(count, "Left"), score=np.ones(count))
    recording = RigRecording(tmp_path)
    assert (recording.fps, recording.count) == (pytest.approx(10.0), 11)
    keypoints = KeypointTracks(files, recording.cameras)
    for done in (0, 4):
        with recording.opened(done) as opened:
            frames = list(opened)
        assert [frame.index for frame in frames] == list(range(done, 11))
        assert [frame.time_s for frame in frames] == pytest.approx([0.1 * i for i in range(done, 11)], abs=1e-9)
        for frame in frames:
            fast, slow = keypoints.hands(frame, None)
            assert fast is not None
            assert slow is not None
            assert float(slow.points_px[0, 0]) - 1 == frame.index
            assert abs((float(fast.points_px[0, 0]) - 1) / 25 - frame.time_s) <= 0.02 + 1e-9


@pytest.mark.parametrize(("label", "is_silent"), [("Left", True), ("Right", False)])  # names of MediaPipe
def test_a_file_without_a_hand_in_a_frame_is_silent_unless_it_knows_other_hands(
    label: str, is_silent: bool, tmp_path: Path
) -> None:
    points = np.ones((3, 21, 2))
    points[1] = np.nan
    np.savez(tmp_path / "points.npz", points_px=points, label=np.array(["Left", "", label]), score=np.ones(3))
    keypoints = KeypointTracks([tmp_path / "points.npz"], [assumed_camera(WIDTH, HEIGHT)])
    image = torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8)
    told = []
    for index, view in enumerate((View(image=image), View(image=image), View())):
        frame = RecordedFrame(index=index, time_s=index / 30, views=(view,), problems=(None,))
        told.append(with_keypoints(frame, keypoints, None).views[0].is_detector_silent)
    assert told == [False, is_silent, False]
    assert not with_keypoints(frame, None, None).views[0].is_detector_silent


def test_frames_that_a_file_does_not_know_are_not_called_empty(tmp_path: Path) -> None:
    points = np.ones((3, 21, 2))
    points[1:] = np.nan
    np.savez(tmp_path / "points.npz", points_px=points, label=np.array(["Left", "", ""]), score=np.ones(3))
    paths, cameras = [tmp_path / "points.npz"], [assumed_camera(WIDTH, HEIGHT)]
    keypoints, view = KeypointTracks(paths, cameras), View(image=torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8))
    frames = [RecordedFrame(index=i, time_s=i / 30, views=(view,), problems=(None,)) for i in range(5)]
    told = [with_keypoints(frame, keypoints, None).views[0].is_detector_silent for frame in frames]
    assert told == [False, True, True, False, False]
    KeypointTracks(paths, cameras, start=2)
    with pytest.raises(InputError, match=r"points.npz: expected keypoints of frame 3 or later, got those of 0 to 2"):
        KeypointTracks(paths, cameras, start=3)
