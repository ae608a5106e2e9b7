"""Webcams, read by OpenCV picture by picture."""

import math
import time
from collections.abc import Iterator

import cv2
import numpy as np

from torchhand.errors import InputError
from torchhand.files.disk import quiet_opencv
from torchhand.files.pictures.frame_source import ASSUMED_FPS, Frame, FrameRange, FrameSource, check_size
from torchhand.files.pictures.pictures import rgb8

_PATIENCE = 3
"""Failed reads in a row after which a webcam has ended, each of which can take seconds."""
_LARGEST_FPS = 1000.0


class WebcamSource(FrameSource):
    """The pictures of a webcam as they are taken; their times are those of their arrival."""

    def __init__(self, name: str, number: int, frames: FrameRange) -> None:
        self.name = name
        self._what, self._frames, self._used = f"webcam {number}", frames, False
        self._capture = _open_webcam(number)
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        self.fps = float(fps) if math.isfinite(fps) and 0 < fps <= _LARGEST_FPS else ASSUMED_FPS
        self.count = frames.within(None)
        self._start_s = 0.0
        self._first: tuple[float, np.ndarray] | None = self._read()
        if self._first is None:
            self.close()
            raise InputError(f"{self._what}: not a single frame can be decoded")
        self._start_s = self._first[0]
        self.height, self.width = self._first[1].shape[:2]

    def __iter__(self) -> Iterator[Frame]:
        if self._used:
            raise ValueError("a source is read once; open it again")
        self._used = True
        wanted, index = self._frames, 0
        while wanted.end is None or index < wanted.end:
            taken = self._first or self._read()
            self._first = None
            if taken is None:
                return
            stamp_s, picture = taken
            if wanted.holds(index):
                image = rgb8(picture, 255.0)
                check_size(f"{self._what}, frame {index}", image, width=self.width, height=self.height)
                yield Frame(index=index, time_s=stamp_s - self._start_s, image=image)
            index += 1

    def close(self) -> None:
        self._capture.release()

    def _read(self) -> tuple[float, np.ndarray] | None:
        """The next picture and when it came; None where the camera gives no more."""
        for _ in range(_PATIENCE):
            with quiet_opencv():
                try:
                    good, picture = self._capture.read()
                except cv2.error:
                    continue
            if good and picture is not None and picture.size:
                return time.monotonic(), picture
        return None


def _open_webcam(number: int) -> cv2.VideoCapture:
    with quiet_opencv():
        capture = cv2.VideoCapture(number)
    if not capture.isOpened():
        raise InputError(f"webcam {number}: cannot be opened (not connected, in use, or no permission)")
    return capture
