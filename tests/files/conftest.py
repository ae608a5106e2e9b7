"""Tiny pictures and videos, made on the spot."""

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

WIDTH, HEIGHT = 64, 48


def _picture(index: int, *, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    image = np.zeros((height, width, 3), np.uint8)
    image[:, : width // 2] = (200, 60, 20)
    for bit in range(6):
        image[bit * height // 6 : (bit + 1) * height // 6, width // 2 :] = 235 * (index >> bit & 1)
    return image


@pytest.fixture
def picture() -> Callable[..., np.ndarray]:
    """picture(i, width=64, height=48): BGR, left half blue; the right shows i in binary, lowest bit on top."""
    return _picture


@pytest.fixture
def make_video(tmp_path: Path) -> Callable[..., Path]:
    """make_video(name, frames) writes a video of `picture(0)`, `picture(1)` ..."""

    def make(name: str = "clip.mp4", frames: int = 12, *, codec: str = "mp4v", fps: float = 25.0) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, (WIDTH, HEIGHT))
        assert writer.isOpened()
        for index in range(frames):
            writer.write(_picture(index))
        writer.release()
        return path

    return make


@pytest.fixture
def make_folder(tmp_path: Path) -> Callable[..., Path]:
    """make_folder({name: BGR array of any depth}) writes a folder of pictures."""

    def make(pictures: dict[str, np.ndarray], name: str = "pictures") -> Path:
        folder = tmp_path / name
        folder.mkdir()
        for file, image in pictures.items():
            assert cv2.imwrite(str(folder / file), image)
        return folder

    return make


@pytest.fixture
def make_clip(tmp_path: Path) -> Callable[..., Path]:
    """make_clip(name, pictures) writes RGB pictures by PyAV: with any codec and format, at any times, turned."""

    def make(
        name: str,
        pictures: Sequence[np.ndarray],
        *,
        codec: str = "libx264",
        pix_fmt: str = "yuv420p",
        times_s: Sequence[float] | None = None,
        fps: int = 25,
        options: dict[str, str] | None = None,
        turned: bool = False,
    ) -> Path:
        path = tmp_path / name
        with av.open(str(path), "w") as container:
            stream = container.add_stream(codec, rate=fps, options=options or {})
            assert isinstance(stream, av.VideoStream)
            stream.height, stream.width = pictures[0].shape[:2]
            stream.pix_fmt = pix_fmt
            if times_s is not None:
                stream.codec_context.time_base = Fraction(1, 1000)
            for index, picture in enumerate(pictures):
                frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                frame.pts = index if times_s is None else round(1000 * times_s[index])
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
        return _turn(path) if turned else path

    return make


def _turn(path: Path) -> Path:
    """Write into the header of an MP4 file that its pictures are to be shown turned by 90 degrees, clockwise."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40  # of version 0: the matrix
    one, turned = (0x10000).to_bytes(4, "big"), (-0x10000).to_bytes(4, "big", signed=True)
    assert data[at : at + 4] == one
    data[at : at + 20] = bytes(4) + one + bytes(4) + turned + bytes(4)
    path.write_bytes(data)
    return path
