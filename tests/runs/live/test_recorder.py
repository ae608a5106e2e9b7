"""Pictures of a camera are kept as videos with their times, one after the other."""

from pathlib import Path

import pytest
import torch

from torchhand.files import open_source
from torchhand.runs.live.recorder import Recorder


def test_a_video_begins_and_ends_where_recording_does(tmp_path: Path) -> None:
    said: list[str] = []
    recorder = Recorder(tmp_path, 30.0, said.append)
    times_s = [0.1 * index + 0.01 * (index % 2) for index in range(12)]
    for index, time_s in enumerate(times_s):
        image = torch.full((48, 64, 3), 20 * index, dtype=torch.uint8)
        recorder.add(time_s, image, records=2 <= index < 6 or index >= 9)
    recorder.close()
    recorder.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["recording_1.mp4", "recording_2.mp4"]
    for name, first, end in (("recording_1.mp4", 2, 6), ("recording_2.mp4", 9, 12)):
        with open_source(tmp_path / name) as source:
            frames = list(source)
        assert [frame.time_s for frame in frames] == pytest.approx([t - times_s[first] for t in times_s[first:end]])
        shown = [float(frame.image.float().mean()) for frame in frames if frame.image is not None]
        assert shown == pytest.approx([20.0 * index for index in range(first, end)], abs=3)
    assert len(said) == 2
    assert "from 0.20 s on" in said[0]


def test_a_disk_that_refuses_is_told_and_tracking_goes_on(tmp_path: Path) -> None:
    said: list[str] = []
    recorder = Recorder(tmp_path / "nowhere", 30.0, said.append)
    for index in range(5):
        recorder.add(0.1 * index, torch.zeros(48, 64, 3, dtype=torch.uint8), records=True)
    recorder.close()
    assert "recording ended" in said[-1]
    assert "cannot be written (no such folder)" in said[-1]
