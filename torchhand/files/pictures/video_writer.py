"""Writing a video, moved into place only when it is whole."""

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
from jaxtyping import UInt8
from torch import Tensor

from torchhand.errors import DiskError, InputError
from torchhand.files.disk import explained_errors, quiet_opencv, temporary_path
from torchhand.files.pictures.frame_source import ASSUMED_FPS

_CODEC = "mp4v"
_SMALLEST_SIDE = 16


class VideoWriter:
    """What `write_video` hands out: takes RGB frames of one size.

    The codec wants even sides: the last column or row of an odd picture is cut off.
    """

    def __init__(self, path: Path, *, width: int, height: int, fps: float) -> None:
        self.frames_written = 0
        self._width, self._height = width, height
        self._even = (width - width % 2, height - height % 2)
        with quiet_opencv():
            codec = cv2.VideoWriter.fourcc(*_CODEC)
            self._writer = cv2.VideoWriter(os.path.abspath(path), cv2.CAP_FFMPEG, codec, fps, self._even)

    @property
    def is_open(self) -> bool:
        return self._writer.isOpened()

    def write(self, image: UInt8[Tensor, "height width 3"]) -> None:
        """Append one RGB frame of the size given at the start."""
        if tuple(image.shape[:2]) != (self._height, self._width):
            raise ValueError(
                f"video: expected frames of {self._width}x{self._height} px, got {image.shape[1]}x{image.shape[0]}"
            )
        width, height = self._even
        with quiet_opencv():
            self._writer.write(cv2.cvtColor(image.cpu().numpy()[:height, :width], cv2.COLOR_RGB2BGR))
        self.frames_written += 1

    def close(self) -> None:
        with quiet_opencv():
            self._writer.release()


@contextlib.contextmanager
def write_video(path: str | Path, *, width: int, height: int, fps: float = ASSUMED_FPS) -> Iterator[VideoWriter]:
    """`with write_video(...) as video: video.write(image)` leaves an MP4 file when the block ends well.

    When it does not, or when not all frames have reached the disk (InputError), what was there before stays.
    """
    if min(width, height) < _SMALLEST_SIDE:
        raise ValueError(f"video: expected sides of at least {_SMALLEST_SIDE} px, got {width}x{height}")
    if not (math.isfinite(fps) and fps > 0):
        raise ValueError(f"video: expected a positive number of frames per second, got {fps}")
    path = Path(path)
    temporary = temporary_path(path)
    with explained_errors(path):
        temporary.touch()  # the system says why it refuses, OpenCV would not
    try:
        writer = VideoWriter(temporary, width=width, height=height, fps=fps)
        if not writer.is_open:
            raise InputError(f"{path}: no video can be written here (MP4 with codec {_CODEC})")
        try:
            yield writer
        finally:
            writer.close()
        arrived = _count_frames(temporary)
        if arrived != writer.frames_written or arrived == 0:
            got = f"expected {writer.frames_written} frames, {arrived} arrived"
            raise DiskError(f"{path}: cannot be written ({got}; is the disk full?)")
        with explained_errors(path):
            os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def _count_frames(path: Path) -> int:
    """Frames of a file that FFmpeg wrote itself a moment ago; OpenCV does not tell when the disk was full."""
    with quiet_opencv():
        capture = cv2.VideoCapture(os.path.abspath(path), cv2.CAP_FFMPEG)
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if capture.isOpened() else 0
        capture.release()
    return max(0, count)
