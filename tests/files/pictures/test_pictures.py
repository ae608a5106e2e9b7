"""Folders of pictures: depth, channels, orientation, damage."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.pictures.frame_source import Frame
from torchhand.files.pictures.frames import open_source
from torchhand.files.pictures.pictures import full_scale, natural_key, read_picture, rgb8


def _image(frame: Frame) -> torch.Tensor:
    assert frame.image is not None
    return frame.image


def _rgb(bgr: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(bgr[..., ::-1].copy())


def test_natural_order_and_numbering(make_folder, picture):
    folder = make_folder({f"img{i}.png": picture(i) for i in (10, 2, 1, 20, 3)})
    (folder / "README.txt").write_text("x")
    with open_source(folder, start=1, max_frames=3) as source:
        assert (source.width, source.height, source.fps, source.count) == (64, 48, 30.0, 3)
        frames = list(source)
    assert [frame.index for frame in frames] == [1, 2, 3]
    for frame, number in zip(frames, (2, 3, 10), strict=True):
        assert torch.equal(_image(frame), _rgb(picture(number)))


def test_natural_keys_sort_numbers_by_value():
    names = ["b1", "a10", "a2b10", "a2b9", "a02", "A1", "1", "a", "²1"]
    order = [path.name for path in sorted(map(Path, names), key=natural_key)]
    assert order == ["1", "a", "A1", "a02", "a2b9", "a2b10", "a10", "b1", "²1"]


@pytest.mark.parametrize("suffix", ["jpg", "jpeg", "png", "bmp", "tif", "tiff", "webp", "ppm", "PNG"])
def test_every_format_is_found_and_read(make_folder, picture, suffix: str):
    with open_source(make_folder({f"a.{suffix}": picture(20)})) as source:
        (frame,) = source
    tolerance = 8.0 if suffix in ("jpg", "jpeg", "webp") else 0.0
    inner = (slice(8, 40), slice(40, 60))
    torch.testing.assert_close(_image(frame)[inner].float(), _rgb(picture(20))[inner].float(), atol=tolerance, rtol=0.0)


def _grey(picture: np.ndarray) -> np.ndarray:
    return picture[..., 2]


def _alpha(picture: np.ndarray) -> np.ndarray:
    return np.dstack([picture, np.full(picture.shape[:2], 128, np.uint8)])


@pytest.mark.parametrize("channels", ["grey", "colour", "alpha"])
@pytest.mark.parametrize("depth", ["uint8", "uint16", "float32", "10bit"])
def test_other_depths_and_channels_become_8_bit_rgb(tmp_path: Path, picture, channels: str, depth: str):
    image = picture(0)
    image[:, 32:] = 255  # white tells the scale
    stored = {"grey": _grey(image), "colour": image, "alpha": _alpha(image)}[channels]
    factor = {"uint8": 1, "uint16": 257, "float32": 1 / 255, "10bit": 1023 / 255}[depth]
    kind = "uint16" if depth == "10bit" else depth
    path = tmp_path / ("a.tiff" if depth == "float32" else "a.png")
    scaled = stored.astype(np.float64) * factor
    plain = [cv2.IMWRITE_TIFF_COMPRESSION, 1] if kind == "float32" else []  # OpenCV 4 loses digits by itself
    assert cv2.imwrite(str(path), (scaled if kind == "float32" else np.rint(scaled)).astype(kind), plain)
    expected = _rgb(image) if channels != "grey" else torch.from_numpy(_grey(image).copy())[..., None].expand(-1, -1, 3)
    assert torch.equal(read_picture(path), expected)


def test_white_is_decided_by_the_first_picture_and_kept(make_folder):
    levels = {"0.png": 4095, "1.png": 100, "2.png": 2048}  # 12-bit camera
    folder = make_folder({name: np.full((16, 16), level, np.uint16) for name, level in levels.items()})
    with open_source(folder, start=1) as source:
        values = [int(_image(frame)[0, 0, 0]) for frame in source]
    assert values == [round(100 * 255 / 4095), round(2048 * 255 / 4095)]


@pytest.mark.parametrize(
    ("largest", "kind", "expected"),
    [
        (255, "uint16", 255),
        (256, "uint16", 1023),
        (1024, "uint16", 4095),
        (4096, "uint16", 16383),
        (16384, "uint16", 65535),
    ]
    + [
        (0, "uint16", 65535),
        (1.0, "float32", 1.0),
        (0.2, "float64", 1.0),
        (200.0, "float32", 255.0),
        (7, "uint8", 255),
    ],
)
def test_full_scale(largest: float, kind: str, expected: float):
    image = np.zeros((4, 4, 3), kind)
    image[1, 2] = largest
    assert full_scale(image) == expected


def test_numbers_that_are_none_become_black_and_what_is_too_bright_white():
    raw = np.array([[np.nan, -1.0, np.inf, 2.0, 0.5]], np.float32)
    assert rgb8(raw, 1.0)[0, :, 0].tolist() == [0, 0, 255, 255, 128]


def test_the_orientation_tag_is_obeyed(tmp_path: Path, picture):
    path = tmp_path / "a.jpg"
    assert cv2.imwrite(str(path), picture(0))
    data = path.read_bytes()
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)  # one entry: orientation 6, turn clockwise
    exif = b"Exif\0\0" + tiff
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:])
    image = read_picture(path)
    assert image.shape == (64, 48, 3)
    assert image[4:28, :, 2].float().mean() > 180.0  # the blue left half has become the upper one


@pytest.mark.parametrize("is_grey", [False, True])
@pytest.mark.parametrize("is_progressive", [False, True])
def test_jpeg_pixels_are_those_of_opencv(tmp_path: Path, is_grey: bool, is_progressive: bool):
    noise = np.random.default_rng(1).integers(0, 255, (53, 67, 3)).astype(np.uint8)
    image = noise[..., 0] if is_grey else cv2.GaussianBlur(noise, (5, 5), 0)
    for sampling in (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444):
        how = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling, cv2.IMWRITE_JPEG_PROGRESSIVE, int(is_progressive)]
        assert cv2.imwrite(str(tmp_path / "a.jpg"), image, how)
        expected = cv2.imread(str(tmp_path / "a.jpg"))
        assert expected is not None
        assert torch.equal(read_picture(tmp_path / "a.jpg"), _rgb(expected))


@pytest.mark.parametrize("channels", ["grey", "colour", "alpha"])
def test_png_pixels_are_those_of_opencv(tmp_path: Path, channels: str):
    noise = np.random.default_rng(2).integers(0, 255, (53, 67, 3)).astype(np.uint8)
    stored = {"grey": _grey(noise), "colour": noise, "alpha": _alpha(noise)}[channels]
    for level in (0, 1, 9):
        assert cv2.imwrite(str(tmp_path / "a.png"), stored, [cv2.IMWRITE_PNG_COMPRESSION, level])
        expected = cv2.imread(str(tmp_path / "a.png"))
        assert expected is not None
        assert torch.equal(read_picture(tmp_path / "a.png"), _rgb(expected))


def test_a_turned_or_transparent_png_is_decoded_as_before(tmp_path: Path, picture) -> None:
    """Chunks that change what is shown: an orientation, and a colour that is transparent."""
    path = tmp_path / "a.png"
    assert cv2.imwrite(str(path), picture(0))
    data = path.read_bytes()
    tiff = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    for kind, content in ((b"eXIf", tiff), (b"tRNS", struct.pack(">HHH", 1, 2, 3))):
        chunk = struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        path.write_bytes(data[:33] + chunk + data[33:])
        expected = cv2.imread(str(path))
        assert expected is not None
        assert torch.equal(read_picture(path), _rgb(expected))


def test_every_bit_of_a_png_is_checked(tmp_path: Path) -> None:
    noise = np.random.default_rng(3).integers(0, 255, (16, 16)).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "a.png"), noise)
    data = (tmp_path / "a.png").read_bytes()
    for place in range(8, len(data), 7):
        (tmp_path / "a.png").write_bytes(data[:place] + bytes((data[place] ^ 16,)) + data[place + 1 :])
        with pytest.raises(InputError, match=r"a\.png: "):
            read_picture(tmp_path / "a.png")


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def _garble(path: Path) -> None:
    path.write_bytes(b"\xff\xd8 this is no picture")


def _empty(path: Path) -> None:
    path.write_bytes(b"")


def _fill_middle(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) * 3 // 4] = bytes(len(data) * 3 // 4 - len(data) // 2)
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("damage", "suffix"),
    [(damage, suffix) for damage in (_truncate, _garble, _empty) for suffix in ("jpg", "png", "tiff", "bmp", "webp")]
    + [(_fill_middle, "jpg"), (_fill_middle, "png")],
)
def test_a_damaged_picture_is_skipped_and_reported(make_folder, damage, suffix: str, capfd):
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    folder = make_folder({f"{i}.{suffix}": noise for i in range(3)})
    damage(folder / f"1.{suffix}")
    with open_source(folder) as source:
        frames = list(source)
    assert [(frame.index, frame.image is None) for frame in frames] == [(0, False), (1, True), (2, False)]
    assert str(frames[1].problem).startswith(f"{folder / f'1.{suffix}'}: ")
    assert capfd.readouterr().err == ""


def test_a_picture_that_vanishes_or_may_not_be_read_is_skipped(make_folder, picture):
    folder = make_folder({f"{i}.png": picture(i) for i in range(3)})
    with open_source(folder) as source:
        (folder / "1.png").unlink()
        frames = list(source)
    assert frames[1].image is None
    assert "1.png: cannot be read (No such file or directory)" in str(frames[1].problem)
    assert torch.equal(_image(frames[2]), _rgb(picture(2)))


def test_a_bad_first_picture_does_not_decide_the_size(make_folder, picture):
    folder = make_folder({f"{i}.png": picture(i) for i in range(3)})
    (folder / "0.png").write_bytes(b"nothing")
    with open_source(folder) as source:
        assert (source.width, source.height) == (64, 48)
        assert [frame.image is None for frame in source] == [True, False, False]


def test_a_picture_of_another_size(make_folder, picture):
    folder = make_folder({"0.png": picture(0), "1.png": picture(1), "2.png": picture(2, width=32)})
    with (
        open_source(folder) as source,
        pytest.raises(InputError, match=r"2.png: expected a picture of 64x48 px like the first, got 32x48"),
    ):
        list(source)


def test_a_start_after_the_last_picture(make_folder, picture):
    folder = make_folder({"0.png": picture(0), "1.png": picture(1)})
    with pytest.raises(InputError, match=r"start 2 lies after the last picture \(1\)"):
        open_source(folder, start=2)
    with open_source(folder, start=1, already_done=1) as source:
        assert list(source) == []


def test_a_single_picture_is_a_sequence_of_one(tmp_path: Path, picture):
    assert cv2.imwrite(str(tmp_path / "hand.png"), picture(3))
    assert cv2.imwrite(str(tmp_path / "hand2.png"), picture(4))
    with open_source(tmp_path / "hand.png") as source:
        (frame,) = source
    assert source.name == "hand"
    assert torch.equal(_image(frame), _rgb(picture(3)))
    with pytest.raises(InputError, match=r"gone.png: cannot be read"):
        read_picture(tmp_path / "gone.png")
