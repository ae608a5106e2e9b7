"""Keep what OpenCV and FFmpeg print off the user's terminal."""

import contextlib
import os
import threading
from collections.abc import Iterator
from typing import Any

import cv2

_SILENT = 0

# FFmpeg decodes in threads of its own and takes its level from the environment when it is first used in the process, so
# it is set on import. A level that the user has set stays.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

_lock = threading.Lock()
_quiet_blocks, _level_before = 0, 0


@contextlib.contextmanager
def quiet_opencv() -> Iterator[None]:
    """OpenCV logs nothing inside the block, nor in other threads meanwhile.

    Its level of logging is one for the process: the first block that is entered keeps it, the last that is left
    restores it. Nothing is ever concluded from what is logged.
    """
    global _quiet_blocks, _level_before
    logging: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 4 has the same two functions at its top level
    with _lock:
        if not _quiet_blocks:
            _level_before = logging.getLogLevel()
            logging.setLogLevel(_SILENT)
        _quiet_blocks += 1
    try:
        yield
    finally:
        with _lock:
            _quiet_blocks -= 1
            if not _quiet_blocks:
                logging.setLogLevel(_level_before)
