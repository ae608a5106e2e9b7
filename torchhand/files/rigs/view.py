"""One camera's pictures within a rig, read in order of its positions; a bad picture never ends the others."""

import contextlib
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files.pictures import (
    ASSUMED_FPS,
    Frame,
    FrameRange,
    FrameSource,
    PictureSource,
    open_source,
    read_picture,
    video_times,
)
from torchhand.files.rigs.timing import is_constant, mean_rate
from torchhand.files.rigs.views import pictures_in

Picture = tuple[UInt8[Tensor, "height width 3"] | None, str | None]
"""A picture, or None and the reason."""

_NUMBER = re.compile(r"(\d+)\D*$")
_SAME_S = 1e-6  # by which two readings of one time differ at most
_TRIES = 20  # pictures in which one of the right size is looked for


@dataclass(frozen=True, kw_only=True)
class RigView:
    """Pictures of one camera by position: the number in a file's name or its place, or the frame of a video."""

    name: str
    path: Path | None
    width: int = 0
    """Width of the pictures, px; 0 where the view cannot be used."""
    height: int = 0
    fps: float = ASSUMED_FPS
    first: int = 0
    """Smallest position."""
    promised: int | None = None
    """Frames by the video's container, or pictures."""
    problem: str | None = None
    """Why the view cannot be used at all."""
    pictures: dict[int, Path] | None = None
    """Pictures by position; None of videos."""
    times_s: Float64[np.ndarray, "pictures"] | None = None
    """Times at which a video's frames are shown, since the first; None where nobody knows."""
    reference: Path | None = None
    """A picture of the right size, which also tells what counts as white in pictures of more than 8 bits."""

    @property
    def is_numbered(self) -> bool:
        """Whether the positions are the numbers in the names of files."""
        return self.pictures is not None and list(self.pictures) == _numbers(list(self.pictures.values()))

    @property
    def is_constant(self) -> bool:
        """Whether the pictures were taken at a constant rate, as far as anybody knows."""
        return self.times_s is None or is_constant(self.times_s, self.fps)

    @property
    def rate(self) -> float:
        """Pictures per second by their times, as far as anybody knows."""
        return self.fps if self.times_s is None else mean_rate(self.times_s) or self.fps

    def in_order(self) -> "RigView":
        """The same view with places in the folder as positions."""
        if self.pictures is None:
            return self
        pictures = dict(enumerate(self.pictures.values()))
        return replace(self, pictures=pictures, first=0)

    def read(self, positions: Iterable[int]) -> Iterator[Picture]:
        """The pictures at growing positions; ends where a video does.

        Raises InputError where a video ends before the first of them.
        """
        if self.problem is not None or self.path is None:
            return itertools.repeat((None, self.problem))
        if self.pictures is None:
            return _video_frames(self.path, positions)
        return _pictures(self, self.pictures, list(positions))

    def read_frames(self, numbers: Iterable[int]) -> Iterator[Picture]:
        """The frames of a video with these numbers among its times; none where a number is -1.

        A frame is known by its time: what the decoder leaves out does not count.
        """
        if self.problem is not None or self.path is None or self.times_s is None:
            return itertools.repeat((None, self.problem))
        return _frames_at(self, self.path, [None if n < 0 else float(self.times_s[n]) for n in numbers])


def _frames_at(view: RigView, path: Path, times_s: Sequence[float | None]) -> Iterator[Picture]:
    """The frame of a video that is shown at each of these times, which grow."""
    with open_source(path) as source:
        frames = iter(source)
        frame = next(frames, None)
        for time_s in times_s:
            if time_s is None:
                yield None, f"{view.name}: no picture of this time"
                continue
            while frame is not None and frame.time_s < time_s - _SAME_S:
                frame = _next_frame(frames)
            if frame is None or frame.time_s > time_s + _SAME_S:
                yield None, f"{path}: no picture can be decoded at {time_s:.3f} s"
            else:
                yield frame.image, frame.problem


def _next_frame(frames: Iterator[Frame]) -> Frame | None:
    """The next one; None at the end, which a picture of another size is too."""
    with contextlib.suppress(InputError):
        return next(frames, None)
    return None


def open_view(name: str, path: Path | None, size: tuple[int, int] | None = None) -> RigView:
    """Look at a folder of pictures or a video. size: of the camera, px; None: that of the first good picture.

    A view that is missing, unreadable or of another size comes back with its `problem`.
    """
    if path is None:
        return RigView(name=name, path=None, problem=f"{name}: no pictures and no video")
    try:
        return _folder(name, path, size) if path.is_dir() else _video(name, path, size)
    except InputError as error:
        return RigView(name=name, path=path, problem=str(error))


def _folder(name: str, folder: Path, size: tuple[int, int] | None) -> RigView:
    paths = pictures_in(folder)
    if not paths:
        return RigView(name=name, path=folder, problem=f"{folder}: holds no pictures")
    problem = ""
    for path in paths if size is None else paths[:_TRIES]:
        try:
            image = read_picture(path)
        except InputError as error:
            problem = problem or str(error)
            continue
        height, width = image.shape[:2]
        if size is not None and (width, height) != size:
            problem = f"{path}: {_wrong_size(name, size, (width, height))}"
            continue
        numbers = _numbers(paths) or list(range(len(paths)))
        return RigView(
            name=name,
            path=folder,
            width=width,
            height=height,
            first=numbers[0],
            promised=len(paths),
            pictures=dict(zip(numbers, paths, strict=True)),
            reference=path,
        )
    return RigView(name=name, path=folder, problem=problem)


def _video(name: str, path: Path, size: tuple[int, int] | None) -> RigView:
    with open_source(path) as source:
        found = (source.width, source.height)
        if size is not None and found != size:
            return RigView(name=name, path=path, problem=f"{path}: {_wrong_size(name, size, found)}")
        view = RigView(name=name, path=path, width=found[0], height=found[1], fps=source.fps, promised=source.count)
    times_s = video_times(path)
    return view if times_s is None else replace(view, times_s=np.array(times_s))


def _wrong_size(name: str, expected: tuple[int, int], got: tuple[int, int]) -> str:
    return (
        f"expected {expected[0]}x{expected[1]} px, the size that camera {name} was calibrated with,"
        f" got {got[0]}x{got[1]}"
    )


def _numbers(paths: list[Path]) -> list[int]:
    """The last number in each name if every name has one, all growing; else nothing."""
    found = [_NUMBER.search(path.stem) for path in paths]
    numbers = [int(match[1]) for match in found if match is not None]
    is_growing = all(b > a for a, b in itertools.pairwise(numbers))
    return numbers if len(numbers) == len(paths) and is_growing else []


def _pictures(view: RigView, pictures: dict[int, Path], positions: list[int]) -> Iterator[Picture]:
    wanted = [pictures.get(position) for position in positions]
    left = [path for path in wanted if path is not None]
    source: Iterator | None = None
    for position, path in zip(positions, wanted, strict=True):
        if path is None:
            yield None, f"{view.path}: no picture of number {position}"
            continue
        if source is None:  # again after a picture of another size, which ends a source
            source = iter(PictureSource(view.name, [view.reference or path, *left], FrameRange(start=1)))
        left = left[1:]
        try:
            frame = next(source)
            yield frame.image, frame.problem
        except InputError as error:
            source = None
            yield None, str(error)


def _video_frames(path: Path, positions: Iterable[int]) -> Iterator[Picture]:
    wanted = iter(positions)
    position, at = next(wanted, None), 0
    source: FrameSource | None = None
    try:
        while position is not None:
            if source is None:
                source, frames = _opened(path, position)
            try:
                frame = next(frames, None)
            except InputError as error:  # a picture of another size
                source.close()
                source, at = None, position
                yield None, f"{path}, frame {at}: {error}"
                position = next(wanted, None)
                continue
            if frame is None:
                return
            if frame.index == position:
                yield frame.image, frame.problem
                position = next(wanted, None)
    finally:
        if source is not None:
            source.close()


def _opened(path: Path, start: int):
    source = open_source(path, start=start)
    return source, iter(source)
