"""Several webcams, or video files as if live: one capture thread each, the newest pictures of one time handed out."""

import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType

from torchhand.errors import InputError
from torchhand.files.live.pairing import LivePictures, LiveSettings, Pairing
from torchhand.files.pictures import FrameSource, is_stream, open_source

_LONGEST_WAIT_S = 0.02  # from one look to the next whether a silent camera has run out of patience
_OF_CAMERAS = re.compile(r"^(rtsps?|rtmps?|srt)://", re.IGNORECASE)  # addresses that go on where they are opened again
_TRIED_AGAIN_S = 20.0  # to connect, where a camera's stream has broken off
_BETWEEN_TRIES_S = 1.0


@dataclass(frozen=True, kw_only=True)
class LiveCounts:
    """What became of a camera's pictures."""

    name: str
    taken: int
    """Pictures that were handed out."""
    dropped: int
    """Pictures that came too late, too early or too fast."""
    unreadable: int
    reconnected: int = 0
    """Times that its stream broke off and was found again."""
    problem: str | None = None
    """Why the camera ended, where that was no ordinary end."""


class LiveRig:
    """Pictures of several cameras while they are taken: a context manager, and an iterator of `LivePictures`.

    Every source is read in a thread of its own. A webcam's pictures are stamped as they arrive; those of a file, or of
    a folder, are handed over at their own times, whether somebody takes them or not. A
    camera that stalls is left out after `LiveSettings.patience_s` until it delivers again, one that has ended for good.
    The stream of a network camera (RTSP, RTMP, SRT) that breaks off is opened again, tried for 20 s. The iteration ends
    with the last camera.
    """

    def __init__(self, sources: Sequence[str | Path | FrameSource], settings: LiveSettings | None = None) -> None:
        """sources: as `open_source` takes them (the text "0" is the first webcam), or open ones.

        Raises InputError for one that cannot be opened, and where there is none.
        """
        if not sources:
            raise InputError("live: expected one camera or more, got none")
        self._stack = ExitStack()
        with self._stack:
            opened = [
                self._stack.enter_context(one if isinstance(one, FrameSource) else open_source(one)) for one in sources
            ]
            self._stack = self._stack.pop_all()
        self._sources = list(zip(opened, sources, strict=True))
        self.sizes = tuple((source.width, source.height) for source in opened)
        self.names = tuple(source.name for source in opened)
        self.fps = min(source.fps for source in opened)
        self._pairing = Pairing(len(opened), settings or LiveSettings())
        self._changed, self._stopped = threading.Condition(), threading.Event()
        self._unreadable, self._reconnected = [0] * len(opened), [0] * len(opened)
        self._problems: list[str | None] = [None] * len(opened)
        self._threads: list[threading.Thread] = []
        self._start_s = 0.0

    def __enter__(self) -> "LiveRig":
        self._start_s = time.monotonic()
        for camera in range(len(self._sources)):
            thread = threading.Thread(target=self._capture, args=(camera,), name=f"camera {camera}", daemon=True)
            self._threads.append(thread)
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop the threads and let go of the cameras; may be called twice."""
        self._stopped.set()
        for thread in self._threads:
            thread.join()
        self._stack.close()

    def __iter__(self) -> Iterator[LivePictures]:
        while True:
            with self._changed:
                while (found := self._pairing.ready(self.now_s())) is None:
                    if self._pairing.is_over:
                        return
                    self._changed.wait(_LONGEST_WAIT_S)
            yield found

    def counts(self) -> tuple[LiveCounts, ...]:
        """Of every camera, until now."""
        with self._changed:
            return tuple(
                LiveCounts(
                    name=source.name,
                    taken=self._pairing.taken[camera],
                    dropped=self._pairing.dropped[camera],
                    unreadable=self._unreadable[camera],
                    reconnected=self._reconnected[camera],
                    problem=self._problems[camera],
                )
                for camera, (source, _) in enumerate(self._sources)
            )

    def now_s(self) -> float:
        """Time since the start, seconds: that of the time stamps."""
        return time.monotonic() - self._start_s

    def _capture(self, camera: int) -> None:
        """Read one camera to its end, or until the rig is closed."""
        source, given = self._sources[camera]
        try:
            while source is not None and not self._stopped.is_set():
                self._read(camera, source, is_camera=isinstance(given, str))
                is_address = isinstance(given, str) and is_stream(given)
                self._problems[camera] = source.ended_early or (
                    f"ended at {self.now_s():.1f} s" if is_address else None
                )
                source = self._opened_again(camera, source, given)
        except InputError as error:  # such as a picture of another size: this camera ends, the others go on
            self._problems[camera] = str(error)
        finally:
            self._tell(partial(self._pairing.end, camera))

    def _read(self, camera: int, source: FrameSource, *, is_camera: bool) -> None:
        """Hand over the pictures of a source: of a camera as they arrive, else at their own times."""
        for frame in source:
            stamp_s = self.now_s() if is_camera else frame.time_s
            if self._stopped.wait(max(0.0, stamp_s - self.now_s())):
                return
            if frame.image is None:
                self._unreadable[camera] += 1
                continue
            add = partial(self._pairing.add, camera, stamp_s, frame.image, self.now_s(), number=frame.index)
            self._tell(add)

    def _opened_again(self, camera: int, source: FrameSource, given: str | Path | FrameSource) -> FrameSource | None:
        """The stream of a network camera that has broken off; None for any other, and where it does not come back.

        Raises InputError where it comes back with pictures of another size.
        """
        is_whole = source.count is not None and source.ended_early is None
        if is_whole or not isinstance(given, str) or _OF_CAMERAS.match(given) is None:
            return None
        end_s = self.now_s() + _TRIED_AGAIN_S
        while self.now_s() < end_s and not self._stopped.wait(_BETWEEN_TRIES_S):
            try:
                found = self._stack.enter_context(open_source(given))
            except InputError:
                continue
            if (found.width, found.height) != self.sizes[camera]:
                raise InputError(f"{self.names[camera]}: came back with pictures of {found.width}x{found.height} px")
            self._reconnected[camera] += 1
            return found
        return None

    def _tell(self, change: Callable[[], None]) -> None:
        with self._changed:
            change()
            self._changed.notify_all()
