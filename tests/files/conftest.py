"""Tiny pictures and videos, made on the spot."""

from collections.abc import Callable
from pathlib import Path

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
