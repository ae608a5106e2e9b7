"""One camera as if live: numbered, at the pictures' own times, the newest each time."""

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.runs import Recording
from torchhand.runs.recordings import LiveCamera

FRAMES = 30


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    for frame in range(FRAMES):
        cv2.imwrite(str(folder / f"{frame}.png"), np.full((24, 32, 3), 8 * frame, np.uint8))
    return folder


def test_a_camera_is_a_recording_that_is_read_once(pictures: Path) -> None:
    recording = LiveCamera(pictures, None, max_frames=4)
    assert isinstance(recording, Recording)
    assert (recording.width, recording.height, recording.count) == (32, 24, 4)
    with recording.opened(0) as frames:
        found = list(frames)
    assert [frame.index for frame in found] == [0, 1, 2, 3]
    for frame in found:
        image = frame.views[0].image
        assert image is not None
        assert frame.time_s == pytest.approx(int(image[0, 0, 0]) / 8 / 30)
    assert recording.latency_s is not None
    told = recording.warnings()
    assert "from a picture to its estimate" in told[0]
    assert "4 pictures used" in told[1]
    assert "a field of view is assumed" in recording.notes[0]


def test_after_a_frame_that_took_long_comes_the_newest_picture(pictures: Path) -> None:
    recording = LiveCamera(pictures, None)
    with recording.opened(0) as frames:
        next(frames)
        while recording.now_s() < 0.7:
            time.sleep(0.01)
        now_s, frame = recording.now_s(), next(frames)
    assert frame.time_s >= now_s - 2 / 30
    assert recording.dropped() >= 15


def test_frames_have_the_numbers_of_their_pictures(pictures: Path) -> None:
    recording = LiveCamera(pictures, None, max_frames=2)
    with recording.opened(0) as frames:
        next(frames)
        time.sleep(0.3)
        frame = next(frames)
    image = frame.views[0].image
    assert image is not None
    assert frame.number(0) == int(image[0, 0, 0]) // 8 > frame.index


def test_a_camera_that_is_not_the_one_of_the_pictures(pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text("[]")
    with pytest.raises(InputError, match=r"cameras.json"):
        LiveCamera(pictures, tmp_path / "cameras.json")
