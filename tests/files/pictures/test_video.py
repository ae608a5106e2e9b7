"""Video files: in order, without trust in the container."""

import weakref
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.pictures import video
from torchhand.files.pictures.frame_source import Frame
from torchhand.files.pictures.frames import open_source
from torchhand.files.pictures.video import VideoSource

FRAMES = 40


def _number(frame: Frame) -> int:
    """The number that the picture shows."""
    assert frame.image is not None
    bands = frame.image[:, 36:60].float().unflatten(0, (6, 8)).mean((1, 2, 3))
    return sum(1 << bit for bit in range(6) if bands[bit] > 128)


def test_frames_come_in_order_as_rgb(make_video):
    with open_source(make_video(frames=12)) as source:
        assert (source.width, source.height, source.fps, source.count) == (64, 48, 25.0, 12)
        frames = list(source)
    assert [frame.index for frame in frames] == list(range(12))
    assert [_number(frame) for frame in frames] == list(range(12))
    left = frames[0].image[8:40, 4:28].float().mean((0, 1))  # pyright: ignore[reportOptionalSubscript]
    torch.testing.assert_close(left, torch.tensor([20.0, 60.0, 200.0]), atol=6.0, rtol=0.0)
    assert source.ended_early is None


@pytest.mark.parametrize(
    ("start", "max_frames", "already_done"), [(3, None, 0), (0, 5, 0), (3, 5, 2), (3, 100, 0), (3, 4, 4)]
)
def test_a_range_of_frames(make_video, start: int, max_frames: int | None, already_done: int):
    last = 12 if max_frames is None else min(12, start + max_frames)
    with open_source(make_video(), start=start, max_frames=max_frames, already_done=already_done) as source:
        frames = list(source)
        assert source.count == len(frames)
    assert [frame.index for frame in frames] == list(range(start + already_done, last))
    assert [_number(frame) for frame in frames] == [frame.index for frame in frames]


def test_a_start_after_the_end_is_an_error_but_nothing_left_to_do_is_none(make_video):
    path = make_video(frames=5)
    with (
        open_source(path, start=5) as source,
        pytest.raises(InputError, match=r"start 5 lies after the last frame \(4\)"),
    ):
        list(source)
    with open_source(path, start=2, already_done=3) as source:
        assert list(source) == []


def test_corrupt_frames_in_the_middle_are_reported_and_the_rest_keeps_its_numbers(make_video, capfd):
    path = make_video(frames=FRAMES)
    data = bytearray(path.read_bytes())
    headers = [i for i in range(len(data)) if data[i : i + 4] == b"\x00\x00\x01\xb6"]  # MPEG-4 picture headers
    assert len(headers) == FRAMES
    for number in (14, 15):
        data[headers[number] : headers[number + 1]] = bytes(headers[number + 1] - headers[number])
    path.write_bytes(data)
    with open_source(path) as source:
        frames = list(source)
    assert [frame.index for frame in frames] == list(range(FRAMES))
    bad = [frame for frame in frames if frame.image is None]
    assert {14, 15} <= {frame.index for frame in bad} <= {14, 15, 16}
    assert bad[0].problem == f"{path}: frame 14 is corrupt"
    assert all(_number(frame) == frame.index for frame in frames[24:])  # from the next key frame on
    assert capfd.readouterr().err == ""


def test_a_video_that_breaks_off_ends_there_without_phantom_frames(make_video, capfd):
    path = make_video("clip.avi", FRAMES, codec="MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with open_source(path) as source:
        frames = list(source)
    assert 10 <= len(frames) < FRAMES - 10
    assert all(_number(frame) == frame.index for frame in frames[:-1])
    assert source.ended_early == f"{path}: the container promises {FRAMES} frames, {len(frames)} could be read"
    assert capfd.readouterr().err == ""


class _Capture:
    """A video whose container says what the test wants; frames that are False cannot be read."""

    def __init__(self, pictures: list, fps: float, count: float) -> None:
        self.pictures, self.fps, self.count = list(pictures), fps, count
        self.seeks = 0

    def isOpened(self) -> bool:
        return True

    def get(self, what: int) -> float:
        return {cv2.CAP_PROP_FPS: self.fps, cv2.CAP_PROP_FRAME_COUNT: self.count}[what]

    def set(self, *_) -> bool:
        self.seeks += 1
        return False

    def read(self):
        picture = self.pictures.pop(0) if self.pictures else False
        return (False, None) if picture is False else (True, picture)

    def grab(self) -> bool:
        return self.read()[0]

    def release(self) -> None:
        pass


@pytest.mark.parametrize("fps", [float("nan"), 0.0, -1.0, 90000.0])
def test_an_impossible_frame_rate_becomes_thirty(monkeypatch, make_video, picture, fps: float):
    monkeypatch.setattr(video, "_open_file", lambda _: _Capture([picture(0)], fps, 1))
    assert open_source(make_video()).fps == 30.0


@pytest.mark.parametrize("count", [-1.0, 0.0, 2.0, 7.0, 500.0, 1e18, float("nan")])
def test_a_container_may_lie_about_its_frame_count(monkeypatch, make_video, picture, count: float):
    capture = _Capture([False, picture(1), picture(2), False, False, picture(5), picture(6)], 30.0, count)
    monkeypatch.setattr(video, "_open_file", lambda _: capture)
    with open_source(make_video(), start=1) as source:
        frames = list(source)
    assert [(frame.index, frame.image is None) for frame in frames] == [
        (1, False), (2, False), (3, True), (4, True), (5, False), (6, False)
    ]  # fmt: skip
    assert [_number(frame) for frame in frames if frame.image is not None] == [1, 2, 5, 6]
    assert capture.seeks == 0
    assert (source.ended_early is not None) == (count == 500.0)


def test_a_video_without_a_single_frame(monkeypatch, make_video):
    monkeypatch.setattr(video, "_open_file", lambda _: _Capture([], 30.0, 100))
    with pytest.raises(InputError, match="not a single frame can be decoded"):
        open_source(make_video())


def test_a_picture_size_that_changes(monkeypatch, make_video, picture):
    pictures = [picture(0), picture(1), picture(2, width=32, height=24)]
    monkeypatch.setattr(video, "_open_file", lambda _: _Capture(pictures, 30.0, 3))
    with (
        open_source(make_video()) as source,
        pytest.raises(InputError, match="frame 2: expected a picture of 64x48 px like the first, got 32x24"),
    ):
        list(source)


def test_a_truncated_container_cannot_be_opened(make_video, capfd):
    path = make_video()
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match=r"clip.mp4: is no video that can be opened"):
        open_source(path)
    assert capfd.readouterr().err == ""


def test_a_source_is_read_once(make_video):
    source = open_source(make_video(frames=2))
    assert len(list(source)) == 2
    with pytest.raises(ValueError, match="read once"):
        next(iter(source))


def test_frames_are_let_go_of(make_video):
    """A stream: memory does not grow with length."""
    handed_out = []
    with open_source(make_video(frames=FRAMES)) as source:
        for frame in source:
            handed_out.append(weakref.ref(frame.image))
            assert sum(image() is not None for image in handed_out) <= 2
    assert len(handed_out) == FRAMES


def test_a_video_with_an_unreliable_index_is_read_whole(data_dir: Path, capfd):
    path = data_dir / "real" / "open_hand_wave" / "hand_white.mov"
    with open_source(path) as source:
        assert isinstance(source, VideoSource)
        assert (source.width, source.height) == (640, 426)
        assert 28.0 < source.fps < 29.0
        kept, indices = {}, []
        for frame in source:
            assert frame.image is not None
            indices.append(frame.index)
            if frame.index in (120, 121):
                kept[frame.index] = frame.image
    assert indices == list(range(206))
    with open_source(path, start=120, max_frames=2) as source:
        again = {frame.index: frame.image for frame in source}
    assert all(np.array_equal(again[i], kept[i]) for i in (120, 121))  # pyright: ignore[reportArgumentType]
    assert capfd.readouterr().err == ""
