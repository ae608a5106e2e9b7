"""Recordings as a run reads them: the views of one camera or several, time after time, from anywhere on."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Protocol, runtime_checkable

from torchhand.errors import InputError
from torchhand.files import (
    FrameSource,
    Offsets,
    RigSource,
    camera_for,
    load_rig,
    open_rig,
    open_source,
    read_picture,
    rig_notes,
)
from torchhand.files.disk import expanded
from torchhand.files.pictures import PICTURE_SUFFIXES, shown_address
from torchhand.files.rigs import mask_paths, unit_in_metres
from torchhand.geometry import Camera
from torchhand.hand import FINGERS
from torchhand.image import BackgroundPlate, fingers_apart, learn_background
from torchhand.track import View
from torchhand.track.multiview import evenly_spaced_frames

ASSUMED_CAMERA = "no --camera given: a field of view is assumed, so distances are metric only up to that assumption"
_MEMORY_BYTES = 2**28  # of the pictures that are held at once where a recording is read backwards
_LOOKED_AHEAD_S = 5.0  # how far an open hand is looked for
_LOOK_EVERY = 5  # frames from one look for it to the next
_UNIT_OF_THE_HAND = "hand"
_UNKNOWN_LENGTH = 300  # frames among which samples are taken where nobody knows how many there are


@dataclass(frozen=True, kw_only=True)
class RecordedFrame:
    """What all cameras give at one time."""

    index: int
    """Index of the frame, counted from 0 at the recording's first frame, also when reading starts later."""
    time_s: float
    views: tuple[View, ...]
    problems: tuple[str | None, ...]
    """Problems, one line for every view whose picture is missing or unreadable."""
    numbers: tuple[int | None, ...] = ()
    """Number of each view's picture among its camera's own, counted from 0; None where there is none. Without them,
    those of the frames."""

    def number(self, view: int) -> int | None:
        """Number of a view's picture among its camera's own, counted from 0; None where there is none."""
        return self.numbers[view] if self.numbers else self.index


@runtime_checkable
class Recording(Protocol):
    """A recording of one camera or several."""

    @property
    def cameras(self) -> Sequence[Camera]:
        """As they took the pictures; the unit of their translations may be unknown."""
        ...

    @property
    def name(self) -> str: ...

    @property
    def source(self) -> str:
        """The input as the user named it."""
        ...

    @property
    def fps(self) -> float: ...

    @property
    def count(self) -> int | None:
        """Frames that are to be tracked; None where nobody knows."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """What the user should know before the run."""
        ...

    def opened(self, done: int) -> AbstractContextManager[Iterator[RecordedFrame]]:
        """The frames after the first `done`."""
        ...

    def warnings(self) -> Sequence[str]:
        """What reading to the end has shown."""
        ...


def reversed_frames(recording: Recording, places: range) -> Iterator[RecordedFrame]:
    """Frames by their places in a recording, the last one first.

    Containers are not trusted to seek: the frames are read in order, as many at a time as fit into a part of the
    memory that does not grow with the recording, and those before them are skipped.
    """
    size = sum(3 * camera.width * camera.height for camera in recording.cameras)
    chunk = max(1, _MEMORY_BYTES // size)
    for begin in reversed(places[::chunk]):
        with recording.opened(begin) as frames:
            held = list(islice(frames, min(chunk, places.stop - begin)))
        while held:
            yield held.pop()


def first_open_hand(recording: Recording) -> int | None:
    """Index of the first frame that surely shows an open hand, of those that are looked at in the first seconds of a
    recording of one camera; None where none does, where what is seen first is a closed hand, or where what comes before
    cannot be tracked to there: the run tells of that when it gets there."""
    has_fingers, begin_s = False, math.nan
    with contextlib.suppress(InputError), recording.opened(0) as frames:
        for place, frame in enumerate(frames):
            begin_s = frame.time_s if place == 0 else begin_s
            if frame.time_s > begin_s + _LOOKED_AHEAD_S:
                break
            image = frame.views[0].image
            seen = None if place % _LOOK_EVERY or image is None else fingers_apart(image)
            if seen == len(FINGERS):
                return frame.index
            if seen == 0 and not has_fingers:
                break
            has_fingers |= seen is not None
    return None


class OneCameraRecording:
    """A video or a folder of pictures; or, as a text, what is read once: an address, or standard input."""

    def __init__(
        self,
        source: str | Path,
        camera: Camera | str | Path | None,
        *,
        start: int = 0,
        max_frames: int | None = None,
    ) -> None:
        """Raises InputError for an input or a camera that is wrong."""
        self.path, self.source, self.start, self.max_frames = source, shown_address(str(source)), start, max_frames
        self.is_live = isinstance(source, str)
        self._warnings: list[str] = []
        self._first: FrameSource | None = open_source(source, start=start, max_frames=max_frames)
        frames = self._first
        self.name, self.fps, self.count = frames.name, frames.fps, frames.count
        self.width, self.height = frames.width, frames.height
        try:
            self.cameras = (camera_for(camera, frames.width, frames.height),)
        except InputError:
            self.close()
            raise
        self.notes: list[str] = []
        if self.cameras[0].is_assumed:
            self.notes.append(ASSUMED_CAMERA)

    @contextlib.contextmanager
    def opened(self, done: int) -> Iterator[Iterator[RecordedFrame]]:
        """The frames after the first `done`."""
        frames = self._first
        if done or frames is None:
            self.close()
            frames = open_source(self.path, start=self.start, max_frames=self.max_frames, already_done=done)
        self._first = None
        try:
            yield self._frames(frames)
        finally:
            self._warnings = [frames.ended_early] if frames.ended_early else []
            frames.close()

    def _frames(self, frames: FrameSource) -> Iterator[RecordedFrame]:
        for frame in frames:
            view = View(image=frame.image)
            yield RecordedFrame(index=frame.index, time_s=frame.time_s, views=(view,), problems=(frame.problem,))

    def warnings(self) -> Sequence[str]:
        """Whether the recording ended early."""
        return self._warnings

    def close(self) -> None:
        """Let go of the source where it has not been read."""
        if self._first is not None:
            self._first.close()
            self._first = None


class RigRecording:
    """The synchronised pictures of several cameras in a folder.

    Raises InputError for wrong cameras, missing pictures, options that do not fit.
    """

    def __init__(
        self,
        folder: Path,
        *,
        cameras: Path | None = None,
        unit: str | None = None,
        masks: bool | None = None,
        offsets: Offsets | None = None,
        start: int = 0,
        max_frames: int | None = None,
    ) -> None:
        """unit: `hand` where it is not known and to be fitted. masks: whether silhouettes are given; where the folder
        holds them if None."""
        self.folder, self._offsets, self.start, self.max_frames = expanded(folder), offsets or {}, start, max_frames
        self.source, self.name = str(self.folder), self.folder.name
        place = self.folder if cameras is None else cameras
        if not self.folder.is_dir():
            raise InputError(f"{folder}: expected a folder with cameras and pictures, found none")
        fits_unit = unit == _UNIT_OF_THE_HAND
        if not fits_unit:
            unit_in_metres(unit, others=(_UNIT_OF_THE_HAND,))
        self.cameras = load_rig(place, unit=1.0 if fits_unit else unit)  # 1: what a unit is, is not known yet
        if len(self.cameras) < 2:
            raise InputError(f"{place}: expected two cameras or more, got {len(self.cameras)}")
        self.camera_names = tuple(camera.name for camera in self.cameras)
        has_masks = any(mask_paths(self.folder, len(self.cameras)))
        self.has_masks = has_masks if masks is None else masks
        with self._open(0) as source:
            self.fps, total = source.fps, source.count
            self.notes = [*([] if fits_unit else rig_notes(self.cameras)), *source.warnings]
            self._said = len(source.warnings)  # warnings that every later reading repeats
            if sum(width > 0 for width, _ in source.sizes[: len(self.cameras)]) < 2:
                raise InputError(f"{self.folder}: expected pictures of two cameras or more; {'; '.join(self.notes)}")
        limits = [limit for limit in (total, max_frames) if limit is not None]
        self.count = min(limits) if limits else None
        self._warnings: list[str] = []
        if self.has_masks:
            self.notes.append("the silhouettes are those in masks_0, masks_1, ...")

    def sample(self, frames: int) -> Iterator[RecordedFrame]:
        """Frames, so many at most, evenly over the part that is tracked, read as they are asked for."""
        chosen = {self.start + place for place in evenly_spaced_frames(self.count or _UNKNOWN_LENGTH, frames)}
        with self._open(0) as source:
            for frame in self._frames(source):
                if frame.index in chosen:
                    yield frame
                    if frame.index == max(chosen):
                        break

    @contextlib.contextmanager
    def opened(self, done: int) -> Iterator[Iterator[RecordedFrame]]:
        """The frames after the first `done`."""
        if self.count is not None and done >= self.count:
            yield iter(())
            return
        with self._open(done) as source:
            yield self._frames(source)
            self._warnings = list(source.warnings[self._said :])

    def warnings(self) -> Sequence[str]:
        """What reading to the end has shown."""
        return self._warnings

    def _frames(self, source: RigSource) -> Iterator[RecordedFrame]:
        for frame in source:
            masks = frame.masks or (None,) * len(self.cameras)
            views = tuple(View(image=image, mask=mask) for image, mask in zip(frame.images, masks, strict=True))
            yield RecordedFrame(
                index=frame.index, time_s=frame.time_s, views=views, problems=frame.problems, numbers=frame.numbers
            )

    def _open(self, done: int) -> RigSource:
        return open_rig(
            self.folder,
            self.cameras,
            offsets=self._offsets,
            start=self.start + done,
            max_frames=None if self.max_frames is None else self.max_frames - done,
            masks=self.has_masks,
        )


def rig_plates(
    cameras: Sequence[Camera], folder: Path | None, method: str, *, has_masks: bool
) -> list[BackgroundPlate] | None:
    """The empty scene in every view where the silhouettes' method asks for it. Raises InputError where it is
    missing."""
    if has_masks or method != "background":
        if folder is not None:
            raise InputError(f"--background: expected --silhouettes background with it, got {method!r}")
        return None
    if folder is None:
        raise InputError("silhouettes background: expected --background with pictures of the empty scene, got none")
    plates = []
    for view, camera in enumerate(cameras):
        names = [f"{stem}{suffix}" for stem in (camera.name, f"view_{view}") for suffix in PICTURE_SUFFIXES]
        path = next((folder / name for name in names if (folder / name).is_file()), None)
        if path is None:
            raise InputError(f"{folder}: expected {camera.name}.png or view_{view}.png, found neither")
        image = read_picture(path)
        if image.shape[:2] != (camera.height, camera.width):
            raise InputError(
                f"{path}: expected {camera.width}x{camera.height} px as camera {camera.name}, got"
                f" {image.shape[1]}x{image.shape[0]}"
            )
        plates.append(learn_background(image[None]))
    return plates
