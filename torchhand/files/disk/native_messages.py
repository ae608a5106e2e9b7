"""Keep what C libraries print (libjpeg, libpng, FFmpeg, OpenCV's own log) off the user's terminal, and read it."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2

_SILENT = 0

# FFmpeg decodes in threads of its own and takes its level from the environment when it is first used in the process, so
# it is set on import. A level that the user has set stays.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@dataclass
class Messages:
    """What was printed, known once the block has ended."""

    text: str = ""


@contextlib.contextmanager
def quiet_opencv() -> Iterator[None]:
    """OpenCV logs nothing inside the block."""
    logging: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 4 has the same two functions at its top level
    before = logging.getLogLevel()
    logging.setLogLevel(_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(before)


@contextlib.contextmanager
def captured_messages() -> Iterator[Messages]:
    """Collect what the block writes to file descriptor 2, below Python.

    For short blocks only: the descriptor belongs to the whole process. Without one (a program with no terminal), or
    with no place for a temporary file, nothing is collected.
    """
    messages = Messages()
    with contextlib.ExitStack() as stack:
        try:
            catcher = stack.enter_context(tempfile.TemporaryFile())
            original = os.dup(2)
        except OSError:
            yield messages
            return
        stack.callback(os.close, original)
        os.dup2(catcher.fileno(), 2)
        try:
            yield messages
        finally:
            os.dup2(original, 2)
            catcher.seek(0)
            messages.text = catcher.read().decode(errors="replace")
