"""Videos that are written whole or not at all."""

import os
from fractions import Fraction
from pathlib import Path

import av
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.pictures.frames import open_source
from torchhand.files.pictures.video_writer import write_video


def _frame(value: int, *, width: int = 64, height: int = 48) -> torch.Tensor:
    image = torch.zeros(height, width, 3, dtype=torch.uint8)
    image[..., 0], image[..., 2] = 220, value
    return image


def _write(path: Path, frames: int, *, width: int = 64, height: int = 48) -> None:
    with write_video(path, width=width, height=height, fps=12.5) as video:
        for i in range(frames):
            video.write(_frame(i, width=width, height=height))


@pytest.mark.parametrize(("width", "height", "frames"), [(64, 48, 1), (64, 48, 20), (65, 49, 3)])
def test_a_video_of_rgb_frames(tmp_path: Path, width: int, height: int, frames: int):
    _write(tmp_path / "overlay.mp4", frames, width=width, height=height)
    with open_source(tmp_path / "overlay.mp4") as source:
        assert (source.width, source.height, source.fps) == (64, 48, 12.5)
        images = [frame.image for frame in source]
    assert len(images) == frames
    assert images[0] is not None
    red, green, blue = images[0].float().mean((0, 1)).tolist()
    assert red > 200
    assert max(green, blue) < 30
    assert [path.name for path in tmp_path.iterdir()] == ["overlay.mp4"]


class _Stop(BaseException):
    """Ctrl-C, without upsetting the test runner."""


def test_an_interrupted_video_leaves_the_old_one(tmp_path: Path):
    path = tmp_path / "overlay.mp4"
    _write(path, 4)
    before = path.read_bytes()

    def interrupted() -> None:
        with write_video(path, width=64, height=48) as video:
            video.write(_frame(0))
            raise _Stop

    with pytest.raises(_Stop):
        interrupted()
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["overlay.mp4"]


@pytest.mark.parametrize("frames", [0, 3])
def test_frames_that_never_reach_the_disk_are_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frames: int):
    path = tmp_path / "overlay.mp4"
    _write(path, 4)
    before = path.read_bytes()
    # A full disk: OpenCV goes on without a word.
    monkeypatch.setattr("torchhand.files.pictures.video_writer.VideoWriter.close", lambda self: None)
    with pytest.raises(
        InputError, match=rf"overlay.mp4: cannot be written \(expected {frames} frames, 0 arrived; is the"
    ):
        _write(path, frames)
    assert path.read_bytes() == before


def test_no_place_and_no_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    with pytest.raises(InputError, match=r"overlay.mp4: cannot be written \(no such folder\)"):
        _write(tmp_path / "nowhere" / "overlay.mp4", 1)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "touch", refuse)
        with pytest.raises(InputError, match=r"overlay.mp4: cannot be written \(no permission to write\)"):
            _write(tmp_path / "overlay.mp4", 1)
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refuse)
        with pytest.raises(InputError, match=r"overlay.mp4: cannot be written \(no permission to write\)"):
            _write(tmp_path / "overlay.mp4", 1)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().err == ""


def test_an_encoder_that_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("torchhand.files.pictures.video_writer._ENCODERS", ("no_such_encoder",))
    with pytest.raises(InputError, match=r"no video can be written here \(PyAV has none of no_such_encoder\)"):
        _write(tmp_path / "overlay.mp4", 1)
    assert list(tmp_path.iterdir()) == []


def test_browsers_play_it(tmp_path: Path):
    """H.264 with 4:2:0 colours, the index before the pictures, so that playing begins at once."""
    _write(tmp_path / "overlay.mp4", 12)
    with av.open(tmp_path / "overlay.mp4") as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.pix_fmt == "yuv420p"
        assert stream.average_rate == Fraction(25, 2)
        assert [frame.time for frame in container.decode(stream)] == pytest.approx([i / 12.5 for i in range(12)])
    data = (tmp_path / "overlay.mp4").read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")


def test_frames_are_shown_at_the_times_given(tmp_path: Path):
    times_s = [0.0, 0.04, 0.1, 0.5, 0.5333333]
    with write_video(tmp_path / "overlay.mp4", width=64, height=48, fps=30000 / 1001) as video:
        for i, time_s in enumerate(times_s):
            video.write(_frame(i), time_s=time_s)
    with open_source(tmp_path / "overlay.mp4") as source:
        assert [frame.time_s for frame in source] == pytest.approx(times_s, abs=2e-5)


def test_wrong_calls(tmp_path: Path):
    with pytest.raises(ValueError, match="sides of at least 16 px, got 8x48"):
        _write(tmp_path / "a.mp4", 1, width=8)
    with (
        pytest.raises(ValueError, match="expected frames of 64x48 px, got 32x48"),
        write_video(tmp_path / "a.mp4", width=64, height=48) as video,
    ):
        video.write(_frame(0, width=32))
    with (
        pytest.raises(ValueError, match="positive number of frames per second, got nan"),
        write_video(tmp_path / "a.mp4", width=64, height=48, fps=float("nan")),
    ):
        pass
