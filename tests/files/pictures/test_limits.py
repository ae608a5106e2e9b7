"""Pictures and videos are refused by their headers, before anything is decoded."""

import os
import socket
import struct
import threading
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.files.pictures import file_identity, input_identity, open_source, pixel_limit, read_picture, sequences_of
from torchhand.files.pictures.formats import declared_size


@pytest.mark.parametrize("suffix", ["jpg", "png", "bmp", "tiff", "webp", "ppm"])
@pytest.mark.parametrize("size", [(61, 40), (3, 500)])
def test_the_size_stands_in_the_header(suffix: str, size: tuple[int, int]):
    image = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3)).astype(np.uint8)
    is_written, data = cv2.imencode(f".{suffix}", image)
    assert is_written
    assert declared_size(data.tobytes()) == size
    for length in range(0, 40):  # cut off within the header: no size, no exception
        assert declared_size(data.tobytes()[:length]) in (None, size)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _large_png(side: int) -> bytes:
    """A black picture that takes side² bytes when it is decoded and a thousandth of that in the file."""
    pack = zlib.compressobj(9)
    rows = b"".join([*(pack.compress(bytes(side + 1)) for _ in range(side)), pack.flush()])
    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", rows) + _chunk(b"IEND", b"")


def test_a_large_picture_is_not_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "black.png"
    path.write_bytes(_large_png(9000))
    assert path.stat().st_size < 200_000
    with monkeypatch.context() as patched:
        patched.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
        with pytest.raises(
            InputError, match=r"black.png: expected at most 64 megapixels, got 9000x9000 px .--max-megapixels"
        ):
            read_picture(path)
        with pytest.raises(InputError, match="at most 64 megapixels"):
            open_source(path)
    with pixel_limit(100.0):
        assert read_picture(path).shape == (9000, 9000, 3)
    with pytest.raises(InputError, match="at most 64 megapixels"):
        read_picture(path)
    with pytest.raises(InputError, match="--max-megapixels: expected a number above 0"), pixel_limit(float("nan")):
        pass


def test_a_large_video_is_not_decoded(make_video, monkeypatch: pytest.MonkeyPatch):
    path = make_video()
    monkeypatch.setattr("torchhand.files.pictures.video.VideoSource._in_order", lambda _: pytest.fail("decoded"))
    with pixel_limit(0.003), pytest.raises(InputError, match=r"clip.mp4: expected at most 0.003 megapixels"):
        open_source(path)


def test_what_is_no_file_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    os.mkfifo("pipe.mp4")
    os.mkfifo("pipe.png")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket.png")
        os.symlink("/dev/zero", "zero.png")
        for name, kind in {
            "pipe.mp4": "pipe",
            "pipe.png": "pipe",
            "socket.png": "socket",
            "zero.png": "device",
        }.items():
            with pytest.raises(InputError, match=f"{name}: cannot be read .*got a {kind}"):
                open_source(name)
        with pytest.raises(InputError, match=r"zero.png: cannot be read \(expected a file, got a device\)"):
            read_picture(Path("zero.png"))


@pytest.mark.parametrize(
    ("source", "complaint"),
    [
        ("", "expected a video, a folder or a webcam number, got an empty name"),
        ("1" * 21, "expected a webcam number of at most 4 digits"),
        ("1" * 5000, "expected a webcam number of at most 4 digits"),
        ("~nosuchuser/a.mp4", "no such home folder"),
        ("ftp://example.com/a.mp4", "expected an address such as http, https, rtsp"),
        ("file:///etc/passwd", "expected an address such as http, https, rtsp"),
        ("a\0.mp4", "cannot be read"),
        (os.fsdecode(b"a\xff.mp4"), r"a\\xff.mp4: expected a name in UTF-8"),
    ],
)
def test_names_that_name_nothing(source: str, complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    for read in (open_source, sequences_of):
        with pytest.raises(InputError, match=complaint):
            read(source)


def test_a_video_whose_name_is_no_utf8(make_video):
    path = make_video()
    renamed = path.with_name(os.fsdecode(b"a\xff.mp4"))
    path.rename(renamed)
    for source in (renamed, renamed.parent):
        with pytest.raises(InputError, match=r"a\\xff.mp4: expected a name in UTF-8"):
            sequences_of(source)


def _damaged_pictures(folder: Path, count: int) -> dict[Path, bool]:
    """Pictures of two formats, and whether each is whole."""
    dice = np.random.default_rng(0)
    whole = {}
    for i in range(count):
        suffix = ("jpg", "png")[i % 2]
        image = cv2.GaussianBlur(dice.integers(0, 255, (96, 128, 3)).astype(np.uint8), (0, 0), 1.5)
        is_written, encoded = cv2.imencode(f".{suffix}", image)
        assert is_written
        data = bytearray(encoded.tobytes())
        if i % 3 == 1:
            del data[len(data) * 2 // 3 :]
        elif i % 3 == 2:
            data[-20:-20] = bytes(200)  # in a JPEG within the coded data, in a PNG in the last rows
        path = folder / f"{i}.{suffix}"
        path.write_bytes(data)
        whole[path] = i % 3 == 0
    return whole


def test_pictures_read_in_three_threads_are_judged_each_by_itself(tmp_path: Path, capfd):
    whole = _damaged_pictures(tmp_path, 60)
    wrong: list[Path] = []

    def read(turn: int) -> None:
        for path in [*whole][turn:] + [*whole][:turn]:
            for _ in range(3):
                try:
                    read_picture(path)
                    is_good = True
                except InputError:
                    is_good = False
                if is_good != whole[path]:
                    wrong.append(path)

    threads = [threading.Thread(target=read, args=(20 * turn,)) for turn in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("options", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 4]])
def test_flipped_bits_of_a_jpeg_are_found_or_harmless(tmp_path: Path, options: list[int], capfd):
    """Where the decoder would have complained, the picture is refused; padding before the end is none."""
    dice = np.random.default_rng(0)
    image = cv2.GaussianBlur(dice.integers(0, 255, (96, 128, 3)).astype(np.uint8), (0, 0), 1.5)
    _, encoded = cv2.imencode(".jpg", image, options)
    data, path, refused = encoded.tobytes(), tmp_path / "a.jpg", 0
    decoded = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    assert decoded is not None
    for padding in (b"", b"\0", bytes(9)):
        path.write_bytes(data[:-2] + padding + data[-2:])
        np.testing.assert_array_equal(read_picture(path), decoded[..., ::-1])
    for _ in range(40):
        broken = bytearray(data)
        broken[dice.integers(700, len(data) - 2)] ^= 1 << dice.integers(8)
        path.write_bytes(broken)
        try:
            read_picture(path)
        except InputError:
            refused += 1
    assert refused >= 3
    path.write_bytes(data[:-2] + bytes(200) + data[-2:])
    with pytest.raises(InputError, match="the coded data of the JPEG are damaged"):
        read_picture(path)
    assert capfd.readouterr().err == ""


def test_the_identity_of_an_input(make_video, make_folder, picture):
    video, folder = make_video(), make_folder({f"{i}.png": picture(i) for i in range(3)})
    before = input_identity(video), input_identity(folder)
    (folder / "notes.txt").write_text("no picture")
    assert (input_identity(video), input_identity(folder)) == before
    video.write_bytes(video.read_bytes()[:-1] + b"x")
    cv2.imwrite(str(folder / "1.png"), picture(7))
    assert input_identity(folder) != before[1]
    (folder / "2.png").unlink()
    assert input_identity(folder)["files"] == 2
    data = bytearray(video.read_bytes())
    data[100] ^= 1
    video.write_bytes(data)
    assert input_identity(video) != before[0]
    assert input_identity("0") == {}


def test_the_identity_of_a_file_beside_the_input(tmp_path: Path):
    file, folder = tmp_path / "points.npz", tmp_path / "points"
    file.write_bytes(bytes(3 << 20))
    folder.mkdir()
    (folder / "0.json").write_text("[0]")
    before = file_identity(file), file_identity(folder)
    assert (file_identity(file), file_identity(folder)) == before
    file.write_bytes(bytes((3 << 20) - 1) + b"x")  # of the same size, and alike for megabytes
    assert file_identity(file) != before[0]
    (folder / "0.json").write_text("[01]")
    assert file_identity(folder) != before[1]
    with pytest.raises(InputError, match=r"cannot be read .No such file"):
        file_identity(tmp_path / "missing.npz")


def test_a_picture_of_a_few_pixels_is_none(tmp_path: Path):
    for side, is_read in ((1, False), (7, False), (8, True)):
        cv2.imwrite(str(tmp_path / "small.png"), np.full((side, 8, 3), 90, np.uint8))
        if is_read:
            assert read_picture(tmp_path / "small.png").shape == (8, 8, 3)
            continue
        with pytest.raises(InputError, match=f"small.png: expected a picture of 8x8 px or more, got 8x{side}$"):
            read_picture(tmp_path / "small.png")
