"""A recording read from its end, a few frames at a time."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch

from torchhand.files import write_video
from torchhand.geometry import Camera, assumed_camera
from torchhand.runs import RecordedFrame
from torchhand.runs.recordings import OneCameraRecording, reversed_frames
from torchhand.track import View

WIDTH, HEIGHT = 40, 30


class _Recording:
    """Frames that are counted while they are read (`Recording`)."""

    name = source = "memory"
    fps = 30.0
    notes: Sequence[str] = ()

    def __init__(self, count: int) -> None:
        self.count: int | None = count
        self.cameras: Sequence[Camera] = (assumed_camera(WIDTH, HEIGHT),)
        self.opened_at: list[int] = []

    @contextmanager
    def opened(self, done: int) -> Iterator[Iterator[RecordedFrame]]:
        self.opened_at.append(done)
        yield (
            RecordedFrame(index=5 + i, time_s=i / self.fps, views=(View(),), problems=(None,))
            for i in range(done, self.count or 0)
        )

    def warnings(self) -> Sequence[str]:
        return ()


@pytest.mark.parametrize("held", [1, 3, 7, 100])
def test_every_frame_comes_once_the_last_one_first(held: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchhand.runs.recordings.recording._MEMORY_BYTES", held * 3 * WIDTH * HEIGHT)
    recording = _Recording(9)
    frames = [frame.index for frame in reversed_frames(recording, range(7))]
    assert frames == [11, 10, 9, 8, 7, 6, 5]
    assert len(recording.opened_at) == -(-7 // held)  # as many pictures at once as the memory holds
    assert [frame.index for frame in reversed_frames(recording, range(2, 5))] == [9, 8, 7]


def test_frames_have_the_times_of_the_video_wherever_reading_starts(tmp_path: Path) -> None:
    times_s = [0.0, 0.04, 0.05, 0.3, 0.31, 0.9]
    with write_video(tmp_path / "a.mp4", width=WIDTH, height=HEIGHT) as video:
        for time_s in times_s:
            video.write(torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8), time_s=time_s)
    recording = OneCameraRecording(tmp_path / "a.mp4", None)
    for done in (0, 3):
        with recording.opened(done) as frames:
            assert [frame.time_s for frame in frames] == pytest.approx(times_s[done:], abs=2e-5)
    backwards = [frame.time_s for frame in reversed_frames(recording, range(len(times_s)))]
    assert backwards == pytest.approx(times_s[::-1], abs=2e-5)
