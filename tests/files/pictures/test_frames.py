"""Choosing a source: what is what, and one clear line for what cannot be read."""

import functools
import http.server
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.files.pictures import container, webcam
from torchhand.files.pictures.frame_source import FrameRange
from torchhand.files.pictures.frames import open_source, sequences_of


def test_a_folder_of_videos_gives_one_sequence_each_in_natural_order(tmp_path: Path, make_video):
    for name in ("take10.mp4", "take2.mp4", "take2.avi"):
        make_video(f"clips/{name}", 1, codec="MJPG" if name.endswith("avi") else "mp4v")
    (tmp_path / "clips" / "notes.txt").write_text("not a video")
    (tmp_path / "clips" / ".hidden.mp4").write_bytes(b"")
    folder = tmp_path / "clips"
    assert sequences_of(folder) == [
        ("take2.avi", folder / "take2.avi"),
        ("take2.mp4", folder / "take2.mp4"),
        ("take10", folder / "take10.mp4"),
    ]
    with pytest.raises(InputError, match="expected a folder of pictures, got one with 3 videos"):
        open_source(folder)


def test_a_single_input_is_one_sequence(tmp_path: Path, make_video, make_folder, picture):
    video = make_video("wave.mp4", 1)
    folder = make_folder({"a.png": picture(0)}, "shots")
    assert sequences_of(str(video)) == [("wave", video)]
    assert sequences_of(folder) == [("shots", folder)]
    assert sequences_of("3") == [("webcam3", "3")]


def test_a_folder_called_by_a_number_is_no_webcam(monkeypatch, tmp_path: Path, make_folder, picture):
    make_folder({"a.png": picture(5)}, "0")
    monkeypatch.chdir(tmp_path)
    with open_source("0") as source:
        assert (source.name, source.count) == ("0", 1)


def test_a_webcam_is_read_until_it_stops(monkeypatch, picture):
    class Webcam:
        def __init__(self, number):
            assert number == 7
            self.reads = 0

        def get(self, _):
            return -1.0

        def read(self):
            self.reads += 1
            return (True, picture(self.reads)) if self.reads <= 4 else (False, None)

        def release(self):
            pass

    monkeypatch.setattr(webcam, "_open_webcam", Webcam)
    with open_source("7") as source:
        assert (source.name, source.fps, source.count) == ("webcam7", 30.0, None)
        frames = list(source)
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    times = [frame.time_s for frame in frames]
    assert times[0] == 0.0
    assert times == sorted(times)


@pytest.mark.parametrize(
    ("address", "name"),
    [("rtsp://ann:secret@camera.example:554/live", "camera_example"), ("udp://127.0.0.1:5000", "127_0_0_1")],
)
def test_an_address_is_one_sequence_that_is_read_once(address: str, name: str):
    assert sequences_of(address) == [(name, address)]


def test_an_address_that_does_not_answer_is_told_without_its_password(capfd):
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with pytest.raises(InputError, match=r"^http://ann:\*\*\*@127.0.0.1:\d+/a.mp4: cannot be read \(") as caught:
        open_source(f"http://ann:secret@127.0.0.1:{port}/a.mp4")
    assert "secret" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_a_video_is_read_from_its_address(make_video):
    path = make_video(frames=5)
    handler = functools.partial(_QuietHandler, directory=str(path.parent))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with open_source(f"http://127.0.0.1:{server.server_port}/{path.name}") as source:
            frames = list(source)
        server.shutdown()
    assert source.name == "127_0_0_1"
    assert [frame.index for frame in frames] == list(range(5))


class _QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.mark.parametrize("name", ["a.mp4", "a.ts"])
def test_a_server_that_tells_no_length_gives_every_frame(make_clip, picture, name: str):
    options = {"bf": "3", "movflags": "+faststart"} if name == "a.mp4" else {"bf": "3"}
    data = make_clip(name, [picture(i) for i in range(20)], options=options).read_bytes()

    class Handler(_QuietHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(data)

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with open_source(f"http://127.0.0.1:{server.server_port}/{name}") as source:
            frames = list(source)  # the decoder holds back the last ones until it is told that no more come
        server.shutdown()
    assert [frame.index for frame in frames] == list(range(20))
    assert name == "a.ts" or source.ended_early is None  # all that its container counts; a stream counts none


def test_an_address_that_says_nothing_is_told_so(monkeypatch):
    monkeypatch.setattr(container, "_PATIENCE_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}/a.ts"
        with pytest.raises(InputError, match=r"/a.ts: cannot be read \(nothing came for 0.5 s\)$"):
            open_source(address)


def test_a_video_comes_through_a_pipe_where_it_can_be_read_in_order(monkeypatch, make_video, make_clip):
    with subprocess.Popen(["cat", str(make_video("a.mkv", 7))], stdout=subprocess.PIPE) as cat:
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=cat.stdout))
        with open_source("-") as source:
            assert [frame.index for frame in source] == list(range(7))
    assert sequences_of("-") == [("stdin", "-")]
    noise = np.random.default_rng(0).integers(0, 256, (20, 120, 160, 3), np.uint8)
    path = make_clip("b.mp4", list(noise))  # its index stands at the end
    with subprocess.Popen(["cat", str(path)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as cat:
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=cat.stdout))
        with pytest.raises(InputError, match="standard input: is no video that can be read in order"):
            open_source("-")


def test_a_missing_webcam(capfd):
    with pytest.raises(InputError, match="webcam 97: cannot be opened"):
        open_source("97")
    assert capfd.readouterr().err == ""


def _missing(path: Path) -> Path:
    return path / "nowhere.mp4"


def _empty_folder(path: Path) -> Path:
    (path / "empty").mkdir()
    return path / "empty"


def _no_pictures(path: Path) -> Path:
    (path / "texts" / "frames").mkdir(parents=True)
    (path / "texts" / "truth.npz").write_bytes(b"0")
    return path / "texts"


def _mixed(path: Path) -> Path:
    (path / "mixed").mkdir()
    for name in ("a.jpg", "b.mp4"):
        (path / "mixed" / name).write_bytes(b"0")
    return path / "mixed"


def _empty_file(path: Path) -> Path:
    (path / "empty.mp4").write_bytes(b"")
    return path / "empty.mp4"


def _text_file(path: Path) -> Path:
    (path / "notes.txt").write_text("hello " * 500)
    return path / "notes.txt"


def _text_in_a_video(path: Path) -> Path:
    return _text_file(path).rename(path / "notes.mp4")


def _bad_pictures(path: Path) -> Path:
    (path / "bad").mkdir()
    for name in ("1.jpg", "2.png"):
        (path / "bad" / name).write_bytes(b"no picture at all")
    return path / "bad"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (_missing, "nowhere.mp4: no such file or folder"),
        (_empty_folder, "empty: is an empty folder"),
        (_no_pictures, "texts: holds no pictures and no videos .*it has the folders frames: give one of them"),
        (_mixed, "mixed: expected pictures or videos, got both .a.jpg, b.mp4"),
        (_empty_file, "empty.mp4: is empty"),
        (_text_file, r"notes.txt: expected a video or a picture \(mp4, mov, .*\), got .txt"),
        (_text_in_a_video, "notes.mp4: is no video that can be opened"),
        (_bad_pictures, "2.png: is no picture that can be decoded .*no picture of 2 could be read"),
    ],
)
def test_bad_inputs_give_one_clear_line(make: Callable[[Path], Path], message: str, tmp_path: Path, capfd):
    with pytest.raises(InputError, match=message) as caught:
        open_source(make(tmp_path))
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def _refuse(*_, **__):
    raise PermissionError(13, "Permission denied")


def test_no_permission_to_read(monkeypatch, make_video, make_folder, picture):
    video, folder = make_video(), make_folder({"1.png": picture(0)})
    monkeypatch.setattr(Path, "open", _refuse)
    monkeypatch.setattr(Path, "read_bytes", _refuse)
    with pytest.raises(InputError, match=r"clip.mp4: cannot be read \(Permission denied\)"):
        open_source(video)
    with pytest.raises(InputError, match=r"1.png: cannot be read \(Permission denied\)"):
        open_source(folder)
    monkeypatch.setattr(Path, "iterdir", _refuse)
    with pytest.raises(InputError, match=r"pictures: cannot be read \(Permission denied\)"):
        sequences_of(folder)


def test_impossible_ranges():
    with pytest.raises(InputError, match="start: expected a frame number of 0 or more, got -1"):
        FrameRange(start=-1)
    with pytest.raises(InputError, match="max_frames: expected 1 or more, got 0"):
        FrameRange(max_frames=0)


@pytest.mark.parametrize(
    ("frames", "total", "expected"),
    [
        (FrameRange(), None, None),
        (FrameRange(), 10, 10),
        (FrameRange(start=4), 10, 6),
        (FrameRange(start=4, max_frames=3), 10, 3),
        (FrameRange(start=4, max_frames=3), None, 3),
        (FrameRange(start=4, max_frames=3, already_done=2), 10, 1),
        (FrameRange(start=4, already_done=6), 10, 0),
        (FrameRange(start=4, max_frames=30), 10, 6),
    ],
)
def test_a_range_knows_how_many_frames_come(frames: FrameRange, total: int | None, expected: int | None):
    assert frames.within(total) == expected
    if total is not None:
        assert sum(frames.holds(index) for index in range(total)) == expected
