"""Live cameras as a recording: read once, told of latency and of what was dropped."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.files import save_cameras
from torchhand.runs import LiveRecording, Recording
from torchhand.simulate import named_rig

SIZE, COUNT = (32, 24), 8


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two folders of pictures, as if cameras, and their calibration."""
    folder = tmp_path_factory.mktemp("live")
    save_cameras(named_rig("frame4", size=SIZE)[:2], folder / "cameras.json")
    for name, count in (("a", COUNT), ("b", COUNT - 3)):
        (folder / name).mkdir()
        for frame in range(count):
            cv2.imwrite(str(folder / name / f"{frame}.png"), np.full((SIZE[1], SIZE[0], 3), 10 * frame, np.uint8))
    return folder


def test_frames_are_numbered_and_times_are_those_of_the_pictures(rig: Path) -> None:
    recording = LiveRecording([rig / "a", rig / "b"], rig / "cameras.json")
    assert isinstance(recording, Recording)
    with recording.opened(0) as frames:
        found = list(frames)
    told = recording.warnings()
    assert [frame.index for frame in found] == list(range(len(found)))
    for frame in found:
        shown = {int(view.image[0, 0, 0]) for view in frame.views if view.image is not None}
        assert len(shown) == 1
        assert frame.time_s == pytest.approx(shown.pop() / 10 / recording.fps)
    *_, last = found
    assert last.views[1].is_empty
    assert last.problems[0] is None
    assert last.problems[1] is not None
    assert "no picture of this time" in last.problems[1]
    assert "from a picture to its estimate" in told[0]
    assert "pictures used" in told[1]


def test_as_many_frames_as_are_asked_for(rig: Path) -> None:
    recording = LiveRecording([rig / "a", rig / "a"], rig / "cameras.json", max_frames=2)
    assert recording.count == 2
    with recording.opened(0) as frames:
        assert len(list(frames)) == 2
    with pytest.raises(ValueError, match="done: expected 0"), recording.opened(3):
        pass


def test_sources_that_are_not_the_cameras(rig: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--live: expected two or more, one for each camera, got 1 sources and 2 cam"):
        LiveRecording([rig / "a"], rig / "cameras.json")
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((10, 12, 3), np.uint8))
    with pytest.raises(InputError, match=r"expected pictures of 32x24 px as camera \w+, got 12x10"):
        LiveRecording([rig / "a", tmp_path], rig / "cameras.json")
