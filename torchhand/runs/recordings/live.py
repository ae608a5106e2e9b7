"""Cameras that are watched while they take pictures, as a recording that is read once."""

import contextlib
import statistics
from collections import deque
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from torchhand.errors import InputError
from torchhand.files import LiveRig, camera_for, load_rig, rig_notes
from torchhand.files.pictures import shown_address
from torchhand.geometry import Camera
from torchhand.runs.recordings.recording import ASSUMED_CAMERA, RecordedFrame
from torchhand.track import View

_NO_PICTURE = "no picture of this time"
_LATENCIES = 100_000  # of the last frames, of which the summary tells


class _Live:
    """Pictures of one time, the newest; those that nobody takes while others are looked at are dropped.

    The cameras run from `opened` on. The end is that of the last camera, of `max_frames`, or the user's Ctrl-C.
    """

    is_live = True
    has_masks = False

    def __init__(self, sources: Sequence[str | Path], max_frames: int | None) -> None:
        """sources: as `open_source` takes them. Raises InputError for those that cannot be opened."""
        self.source, self.max_frames = ",".join(shown_address(str(source)) for source in sources), max_frames
        self._rig = LiveRig(sources)
        self.fps, self.count = self._rig.fps, max_frames
        self.cameras: tuple[Camera, ...] = ()
        self.notes: list[str] = []
        self._latencies_s: deque[float] = deque(maxlen=_LATENCIES)

    def close(self) -> None:
        """Let go of the cameras; may be called twice."""
        self._rig.close()

    @contextlib.contextmanager
    def opened(self, done: int) -> Iterator[Iterator[RecordedFrame]]:
        """The frames from now on. Raises ValueError where the first ones are not to be read: these are gone."""
        if done:
            raise ValueError(f"done: expected 0, for live cameras are not read again, got {done}")
        with self._rig:
            yield self._numbered()

    @property
    def latency_s(self) -> float | None:
        """From the last picture to its estimate; None before there is one."""
        return self._latencies_s[-1] if self._latencies_s else None

    def now_s(self) -> float:
        """Time since the start, seconds: that of the pictures."""
        return self._rig.now_s()

    def dropped(self) -> int:
        """Pictures of all cameras that nobody had the time to look at."""
        return sum(one.dropped for one in self._rig.counts())

    def warnings(self) -> Sequence[str]:
        """Latency, and what became of every camera's pictures."""
        found = []
        if self._latencies_s:
            ordered = sorted(self._latencies_s)
            late_ms = 1e3 * ordered[min(len(ordered) - 1, round(0.95 * len(ordered)))]
            median_ms = 1e3 * statistics.median(ordered)
            found.append(f"from a picture to its estimate: {median_ms:.0f} ms (median), {late_ms:.0f} ms in 95 %")
        for one, camera in zip(self._rig.counts(), self.cameras, strict=True):
            unread = f", {one.unreadable} unreadable" if one.unreadable else ""
            unread += f", connected again {one.reconnected} times" if one.reconnected else ""
            ended = f"; {one.problem}" if one.problem else ""
            found.append(f"camera {camera.name}: {one.taken} pictures used, {one.dropped} dropped{unread}{ended}")
        return found

    def _numbered(self) -> Iterator[RecordedFrame]:
        for index, pictures in enumerate(islice(self._rig, self.max_frames)):
            yield RecordedFrame(
                index=index,
                time_s=pictures.time_s,
                views=tuple(View(image=image) for image in pictures.images),
                problems=tuple(
                    f"camera {camera.name}: {_NO_PICTURE}" if image is None else None
                    for camera, image in zip(self.cameras, pictures.images, strict=True)
                ),
                numbers=pictures.numbers,
            )
            self._latencies_s.append(self.now_s() - pictures.time_s)  # who looked at it comes back


class LiveCamera(_Live):
    """One webcam, stream, video file or folder of pictures as if live (`Recording`)."""

    def __init__(
        self, source: str | Path, camera: Camera | str | Path | None, *, max_frames: int | None = None
    ) -> None:
        """source: as `open_source` takes it. camera: its own, or a file of its calibration; a field of view is assumed
        without one.

        Raises InputError for a source that cannot be opened, and for a camera that is wrong.
        """
        super().__init__([source], max_frames)
        self.path = source
        [(self.width, self.height)], [self.name] = self._rig.sizes, self._rig.names
        try:
            self.cameras = (camera_for(camera, self.width, self.height),)
        except InputError:
            self.close()
            raise
        self.notes = [ASSUMED_CAMERA] if self.cameras[0].is_assumed else []


class LiveRecording(_Live):
    """Webcams, or video files as if live (`Recording`)."""

    def __init__(
        self,
        sources: Sequence[str | Path],
        cameras: Path,
        *,
        unit: str | None = None,
        max_frames: int | None = None,
    ) -> None:
        """sources: as `open_source` takes them, in the order of the cameras. cameras: file, or folder of the rig.

        Raises InputError for sources that cannot be opened, wrong cameras, and pictures that are not theirs.
        """
        rig = load_rig(cameras, unit=unit)
        if len(rig) < 2 or len(sources) != len(rig):
            got = f"{len(sources)} sources and {len(rig)} cameras in {cameras}"
            raise InputError(f"--live: expected two or more, one for each camera, got {got}")
        super().__init__(sources, max_frames)
        self.folder, self.name, self.cameras = cameras, "live", tuple(rig)
        for source, camera, size in zip(sources, self.cameras, self._rig.sizes, strict=True):
            if size != (camera.width, camera.height):
                own = f"{camera.width}x{camera.height}"
                self._rig.close()
                raise InputError(
                    f"--live {source}: expected pictures of {own} px as camera {camera.name}, got {size[0]}x{size[1]}"
                )
        self.notes = list(rig_notes(self.cameras))
