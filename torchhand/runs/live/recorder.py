"""The pictures of a camera as they come, kept as videos in a thread of their own."""

import contextlib
import queue
import threading
from collections.abc import Callable
from pathlib import Path

from jaxtyping import UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import write_video

_WAITING = 120  # pictures that may wait for the encoder

_Picture = tuple[float, UInt8[Tensor, "height width 3"]]


class Recorder:
    """One video after the other: `recording_1.mp4`, `recording_2.mp4` ..., with the times of the pictures."""

    def __init__(self, folder: Path, fps: float, say: Callable[[str], None]) -> None:
        self._folder, self._fps, self._say = folder, fps, say
        self._pictures: queue.Queue[_Picture | None] | None = None
        self._thread: threading.Thread | None = None
        self._dropped = 0

    def add(self, time_s: float, image: UInt8[Tensor, "height width 3"], *, records: bool) -> None:
        """One more picture. records: whether it is to be kept; a video begins and ends where this changes."""
        if not records:
            self.close()
            return
        if self._pictures is None:
            self._pictures, self._dropped = queue.Queue(_WAITING), 0
            path = self._free_path()
            self._say(f"recording the camera's pictures from {time_s:.2f} s on: {path}")
            arguments = (path, self._pictures, image.shape[1], image.shape[0])
            self._thread = threading.Thread(target=self._write, args=arguments, name="recorder", daemon=True)
            self._thread.start()
        try:
            self._pictures.put_nowait((time_s, image))
        except queue.Full:
            self._dropped += 1

    def close(self) -> None:
        """End the video that grows, if one does, and wait until it is whole."""
        if self._pictures is None or self._thread is None:
            return
        self._pictures.put(None)
        self._thread.join()
        if self._dropped:
            self._say(f"recording: {self._dropped} pictures came too fast for the encoder")
        self._pictures = self._thread = None

    def _free_path(self) -> Path:
        number = 1
        while (path := self._folder / f"recording_{number}.mp4").exists():
            number += 1
        return path

    def _write(self, path: Path, pictures: "queue.Queue[_Picture | None]", width: int, height: int) -> None:
        try:
            with write_video(path, width=width, height=height, fps=self._fps) as video:
                first_s: float | None = None
                while (found := pictures.get()) is not None:
                    time_s, image = found
                    first_s = time_s if first_s is None else first_s
                    video.write(image, time_s=time_s - first_s)
        except InputError as error:
            self._say(f"recording ended: {error}")
            with contextlib.suppress(queue.Empty):
                while pictures.get(timeout=1.0) is not None:
                    pass
