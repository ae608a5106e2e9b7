"""Video files and webcams, read in order and never by seeking."""

import math
import os
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from torchhand.errors import InputError
from torchhand.files.disk import check_name, check_plain_file, quiet_opencv
from torchhand.files.pictures.frame_source import ASSUMED_FPS, Frame, FrameRange, FrameSource, check_size
from torchhand.files.pictures.limits import size_problem
from torchhand.files.pictures.pictures import rgb8

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg")

FILE_PATIENCE = 300
"""Failed reads in a row after which a video file has ended; at the true end each costs microseconds."""
WEBCAM_PATIENCE = 3
"""Failed reads in a row after which a webcam has ended, each of which can take seconds."""
_LARGEST_FPS = 1000.0
_LARGEST_COUNT = 10**8


class VideoSource(FrameSource):
    """Frames of a video file or a webcam.

    OpenCV's seeking trusts the container's index, which may be wrong; so the frames before the range are read and
    dropped. A failed read is a corrupt frame if a later read succeeds, and the end of the video if none does within
    `FILE_PATIENCE`; the container's frame count is not asked.
    """

    def __init__(self, name: str, device: Path | int, frames: FrameRange) -> None:
        self.name = name
        self._what = f"webcam {device}" if isinstance(device, int) else str(device)
        self._patience = WEBCAM_PATIENCE if isinstance(device, int) else FILE_PATIENCE
        self._frames, self._used = frames, False
        self._capture = _open_webcam(device) if isinstance(device, int) else _open_file(device)
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        self.fps = float(fps) if math.isfinite(fps) and 0 < fps <= _LARGEST_FPS else ASSUMED_FPS
        count = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self._promised = int(count) if math.isfinite(count) and 0 < count < _LARGEST_COUNT else None
        self.count = frames.within(self._promised)
        # Everything up to the first good frame is read here, for its size, and handed out later.
        self._peeked: deque[np.ndarray | None] = deque()
        while (picture := self._read()) is None:
            self._peeked.append(None)
            if len(self._peeked) > self._patience:
                self.close()
                raise InputError(f"{self._what}: not a single frame can be decoded")
        self._peeked.append(picture)
        self.height, self.width = picture.shape[:2]

    def __iter__(self) -> Iterator[Frame]:
        if self._used:
            raise ValueError("a source is read once; open it again")
        self._used = True
        wanted, index, bad = self._frames, 0, 0  # bad: failed reads since the last good frame, index - 1
        if wanted.within(None) == 0:
            return
        while wanted.end is None or index < wanted.end:
            picture = self._next(decode=index + bad >= wanted.first)
            if picture is None:
                bad += 1
                if bad > self._patience:
                    self._report_end(index)
                    return
                continue
            for lost in range(index, index + bad):
                if wanted.holds(lost):
                    yield Frame(index=lost, image=None, problem=f"{self._what}: frame {lost} is corrupt")
            index, bad = index + bad, 0
            if wanted.holds(index):
                image = rgb8(picture, 255.0)
                check_size(f"{self._what}, frame {index}", image, width=self.width, height=self.height)
                yield Frame(index=index, image=image)
            index += 1

    def close(self) -> None:
        self._capture.release()

    def _report_end(self, total: int) -> None:
        """Called with the number of frames that the file turned out to hold."""
        if total <= self._frames.start:
            raise InputError(f"{self._what}: start {self._frames.start} lies after the last frame ({total - 1})")
        if self._promised is not None and total < self._promised:
            self.ended_early = f"{self._what}: the container promises {self._promised} frames, {total} could be read"

    def _next(self, *, decode: bool) -> np.ndarray | None:
        """The next frame, or None where it cannot be read; frames that nobody wants come as an empty array."""
        if self._peeked:
            return self._peeked.popleft()
        if decode:
            return self._read()
        with quiet_opencv():
            return np.empty((0, 0, 3), np.uint8) if self._capture.grab() else None

    def _read(self) -> np.ndarray | None:
        with quiet_opencv():
            try:
                good, picture = self._capture.read()
            except cv2.error:
                return None
        return picture if good and picture is not None and picture.size else None


def _open_file(path: Path) -> cv2.VideoCapture:
    check_name(path)
    if not check_plain_file(path):
        raise InputError(f"{path}: is empty (0 bytes)")
    try:
        path.open("rb").close()  # the system says why it refuses, FFmpeg would not
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    with quiet_opencv():
        # An absolute path, because FFmpeg takes "a:b.mp4" for a protocol; and FFmpeg by name, because other backends
        # read numbered pictures as a video.
        capture = cv2.VideoCapture(os.path.abspath(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise InputError(f"{path}: is no video that can be opened (cut off, corrupt or of an unknown format)")
    size = (int(capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if problem := size_problem(*size):  # by the container's header: nothing has been decoded so far
        capture.release()
        raise InputError(f"{path}: {problem} (--max-megapixels)")
    return capture


def _open_webcam(number: int) -> cv2.VideoCapture:
    with quiet_opencv():
        capture = cv2.VideoCapture(number)
    if not capture.isOpened():
        raise InputError(f"webcam {number}: cannot be opened (not connected, in use, or no permission)")
    return capture
