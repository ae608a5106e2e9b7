"""Synchronised pictures of all cameras of a rig, frame by frame, each view with a reason where it has none."""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files.disk import expanded, suggestion
from torchhand.files.rigs.faults import FrozenViews, blackness
from torchhand.files.rigs.timing import PairedTimes, pair_times
from torchhand.files.rigs.view import Picture, RigView, open_view
from torchhand.files.rigs.views import find_views, mask_paths, view_paths
from torchhand.geometry import Camera

Offsets = Mapping[str, int | float]
"""By the names of cameras, how long they started before the others: whole numbers of frames, or seconds."""
_OFFSET = re.compile(r"[+-]?(\d{1,9}|(?P<seconds>\d{0,9}\.?\d{1,9}s))")
_SAME_END_S = 0.1
_MIN_AGREEMENT = 0.5  # share of the shortest view's numbers that all views have


@dataclass(frozen=True, kw_only=True)
class RigFrame:
    """One frame: a picture per camera, in the cameras' order."""

    index: int
    """Index of the frame, counted from 0 at the rig's first one, also when reading starts later."""
    time_s: float
    """Time of the frame since the rig's first one."""
    numbers: tuple[int | None, ...]
    """Number of each camera's picture among its own, counted from 0; None where it has none of that time."""
    images: tuple[UInt8[Tensor, "_height _width 3"] | None, ...]
    """Pictures, RGB; None where a view is missing, unreadable, of another size, black or frozen."""
    problems: tuple[str | None, ...]
    """Problems, one line for every picture that is None."""
    masks: tuple[Bool[Tensor, "_height _width"] | None, ...] | None = None
    """The given silhouettes, None where one is missing; None where none were asked for."""


class RigSource:
    """A context manager and an iterator of `RigFrame`; read once and in order, one frame in memory.

    Pictures belong together by the number in their names where all views are folders of pictures whose numbers agree,
    else by their place; those of videos by their times where rates differ or vary, or where an offset is in seconds
    (`pair_times`). A camera's offset is added to its positions: an offset of 3 takes its picture number 3 with number 0
    of the others, one of 0.1 s what it took 0.1 s after its first with the first of the others. Reading ends with the
    shortest view.
    """

    def __init__(
        self,
        views: Sequence[RigView],
        *,
        offsets: Offsets | None = None,
        start: int = 0,
        max_frames: int | None = None,
        every: int = 1,
        keep_all: bool = False,
        mask_views: int = 0,
    ) -> None:
        """keep_all: frames count that any view has a numbered picture of, not only those between all views' ends.

        mask_views: so many of the last views are the silhouettes of the others, in their order.

        Raises InputError: no view can be used, an offset of an unknown camera, a start after the end.
        """
        if start < 0 or every < 1 or (max_frames is not None and max_frames < 1):
            raise InputError(
                "start, max_frames, every: expected a start of 0 or more and the others 1 or more,"
                f" got {start}, {max_frames}, {every}"
            )
        self.warnings: list[str] = []
        """Lines for the user; more may come while reading."""
        self.names = tuple(view.name for view in views)
        self._cameras = len(views) - mask_views
        self._offsets = _offsets(self.names, offsets or {})
        self._views = self._aligned(views, keep_all=keep_all)
        usable = [view for view in self._views if view.problem is None]
        if not usable:
            problems = "; ".join(view.problem or "" for view in self._views)
            raise InputError(f"no view can be used: {problems}")
        self.warnings[:0] = [f"{view.name} is left out: {view.problem}" for view in self._views if view.problem]
        self.sizes = tuple((view.width, view.height) for view in self._views)
        """Width and height of each view, px; zeros of those left out."""
        self.has_videos = any(view.pictures is None for view in usable)
        self._timed = usable
        self._pairs = self._paired(usable, every)
        self.fps = usable[0].fps if self._pairs is None else every * self._pairs.fps or usable[0].fps
        self._length_warnings(usable)
        frames = self._frame_positions_of(usable, keep_all=keep_all)
        self._frame_positions = frames if frames is None else frames[::every]
        known = self._pairs if self._frame_positions is None else self._frame_positions
        self._start, self._every, self._shift = start, every, self._first(usable)
        length = self._length(usable, known)
        if length == 0 and any(self._offsets):
            own = zip(self.names[: self._cameras], self._offsets, strict=False)  # without those of masks
            given = ", ".join(f"{name}={offset:g}" for name, offset in own if offset)
            raise InputError(f"offset: expected frames that all views have, got none with {given}")
        if length is not None and start >= length:
            raise InputError(f"start {start} lies after the last frame ({length - 1})")
        stops = [max_frames and start + max_frames, known and len(known)]
        self._stop = min((stop for stop in stops if stop), default=None)
        ends = [end for end in (length, self._stop) if end is not None]
        self.count = min(ends) - start if ends else None
        """How many frames this reading will deliver, for a progress bar; None where nobody knows."""
        self._used = False
        self._readers: list[Iterator[Picture]] = []

    def __iter__(self) -> Iterator[RigFrame]:
        if self._used:
            raise ValueError("a source is read once; open it again")
        self._used = True
        self._readers = [self._reader(view) for view in range(len(self._views))]
        frozen = FrozenViews(self.names)
        for index in itertools.count(self._start):
            if self._stop is not None and index >= self._stop:
                return
            pictures = [next(reader, None) for reader in self._readers]
            if any(picture is None for picture in pictures):
                self._report_end(pictures, index)
                return
            images, problems = zip(*(picture for picture in pictures if picture is not None), strict=True)
            problems = [
                problem or (blackness(name, image) if image is not None and view < self._cameras else None)
                for view, (name, image, problem) in enumerate(zip(self.names, images, problems, strict=True))
            ]
            problems = frozen.check(images, problems)
            good = tuple(None if p else image for p, image in zip(problems, images, strict=True))
            count = self._cameras
            yield RigFrame(
                index=index,
                time_s=index * self._every / self.fps if self._pairs is None else float(self._pairs.time_s[index]),
                numbers=tuple(self._number(view, index) for view in range(count)),
                images=good[:count],
                problems=tuple(problems[:count]),
                masks=None if count == len(good) else tuple(m if m is None else m[..., 0] > 127 for m in good[count:]),
            )

    def close(self) -> None:
        """Let go of the files; may be called twice."""
        for reader in self._readers:
            close = getattr(reader, "close", None)
            if close is not None:
                close()
        self._readers = []

    def __enter__(self) -> "RigSource":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _reader(self, view: int) -> Iterator[Picture]:
        indices = itertools.count(self._start) if self._stop is None else range(self._start, self._stop)
        if self._pairs is None:
            return self._views[view].read(self._position(view, index) for index in indices)
        if self._views[view] not in self._timed:
            return self._views[view].read(indices)
        numbers = self._pairs.numbers[self._start : self._stop, self._timed.index(self._views[view])]
        return self._views[view].read_frames(numbers.tolist())

    def _position(self, view: int, index: int) -> int:
        """Of a view's picture in a frame, where pictures belong together by number or place."""
        frames = self._frame_positions
        common = self._shift + index * self._every if frames is None else frames[index]
        return common + int(self._offsets[view])

    def _number(self, view: int, index: int) -> int | None:
        """Of a view's picture in a frame, counted from 0 at its first."""
        if self._pairs is None:
            return self._position(view, index) - self._views[view].first
        if self._views[view] not in self._timed:
            return None
        number = int(self._pairs.numbers[index, self._timed.index(self._views[view])])
        return None if number < 0 else number

    def _paired(self, usable: list[RigView], every: int) -> PairedTimes | None:
        """The frames by time, where number or place does not tell which pictures belong together."""
        has_seconds = any(isinstance(self._offset(view), float) for view in usable)
        if not has_seconds and len({view.fps for view in usable}) == 1 and all(view.is_constant for view in usable):
            return None
        times = [view.times_s for view in usable if view.times_s is not None]
        if len(times) < len(usable) or self._cameras < len(self._views):
            if has_seconds:
                raise InputError("offset: expected seconds for videos, all of which tell their times, without masks")
            if len({view.fps for view in usable}) > 1:
                texts = ", ".join(f"{view.name} {view.fps:g}" for view in usable)
                self.warnings.append(f"the views differ in frames per second ({texts}): they cannot stay synchronous")
            return None
        try:
            whole = pair_times([own - self._offset_s(view) for view, own in zip(usable, times, strict=True)])
        except ValueError as error:
            raise InputError(f"offset: {error}; expected fewer frames or seconds") from error
        if len(usable) > 1:
            rates = ", ".join(f"{view.name} {view.rate:g}" for view in usable)
            self.warnings.append(
                f"pictures are paired by their times ({rates} per second): {len(whole)} frames,"
                f" up to {1e3 * whole.furthest_s:.0f} ms apart"
            )
        return whole.every(every)

    def _offset_s(self, view: RigView) -> float:
        offset = self._offset(view)
        return offset if isinstance(offset, float) else offset / view.rate

    def _aligned(self, views: Sequence[RigView], *, keep_all: bool) -> list[RigView]:
        """Positions that mean the same in all views: numbers that they share, else places."""
        usable = [view for view in views if view.problem is None]
        if usable and all(view.is_numbered for view in usable):
            numbers = [self._numbers(view) for view in usable]
            if keep_all:
                agree = len(usable) == 1 or any(a & b for a, b in itertools.combinations(numbers, 2))
            else:
                agree = len(set.intersection(*numbers)) >= _MIN_AGREEMENT * min(map(len, numbers))
            if agree:
                if len({min(found) for found in numbers}) > 1 and not keep_all:
                    texts = ", ".join(f"{view.name} {view.first}" for view in usable)
                    self.warnings.append(f"the first numbers differ ({texts}): pictures of one number belong together")
                return list(views)
            self.warnings.append("pictures belong together by their place: the numbers in their names do not agree")
        return [view.in_order() for view in views]

    def _numbers(self, view: RigView) -> set[int]:
        """Numbers of its pictures as a camera without offset would have them."""
        return {position - int(self._offset(view)) for position in view.pictures or ()}

    def _frame_positions_of(self, usable: Sequence[RigView], *, keep_all: bool) -> list[int] | None:
        """Positions for a camera without offset; None where only reading tells the end."""
        folders = [view for view in usable if view.pictures is not None]
        if not folders:
            return None
        numbers = [self._numbers(view) for view in folders]
        found = sorted(set.union(*numbers))
        if len(folders) < len(usable):  # a video has every number
            found = list(range(found[0], found[-1] + 1))
        if keep_all:
            return found
        first, last = self._first(usable), min(map(max, numbers))
        return [number for number in found if first <= number <= last]

    def _first(self, usable: Sequence[RigView]) -> int:
        """Position of the first frame, for a camera without offset."""
        return max(view.first - int(self._offset(view)) for view in usable)

    def _offset(self, view: RigView) -> int | float:
        return self._offsets[self.names.index(view.name)]

    def _length_warnings(self, usable: Sequence[RigView]) -> None:
        lengths = {view.name: view.promised for view in usable if view.promised is not None}
        if self._pairs is not None:
            ends = {view.name: (view.promised or 0) / view.rate - self._offset_s(view) for view in usable}
            if max(ends.values()) - min(ends.values()) > _SAME_END_S:
                texts = ", ".join(f"{name} {end:.1f} s" for name, end in ends.items())
                self.warnings.append(f"the views end at different times ({texts}): reading ends with the first")
        elif len(set(lengths.values())) > 1:
            texts = ", ".join(f"{name} {length}" for name, length in lengths.items())
            self.warnings.append(f"the views differ in length ({texts} frames): reading ends with the shortest")

    def _length(self, usable: Sequence[RigView], known: Sized | None) -> int | None:
        """How many frames there are from the first one on, as the files promise; None where nobody knows. known: those
        whose pictures are known already."""
        ends = [
            -(-(view.promised - self._shift - self._offset(view)) // self._every)
            for view in usable
            if view.promised is not None and view.pictures is None and self._pairs is None
        ]
        ends += [] if known is None else [len(known)]
        return max(0, int(min(ends))) if ends else None

    def _report_end(self, pictures: Sequence[Picture | None], index: int) -> None:
        usable = [view.problem is None for view in self._views]
        ended = [name for name, picture in zip(self.names, pictures, strict=True) if picture is None]
        going = [
            name
            for name, picture, is_usable in zip(self.names, pictures, usable, strict=True)
            if picture is not None and is_usable
        ]
        if going:
            self.warnings.append(f"{', '.join(ended)} ended after {index} frames, {', '.join(going)} go on")


def open_rig(
    folder: str | Path,
    cameras: Sequence[Camera],
    *,
    offsets: Offsets | None = None,
    start: int = 0,
    max_frames: int | None = None,
    masks: bool = False,
) -> RigSource:
    """The recording of calibrated cameras: view_K/ or NAME/ pictures, or NAME.mp4, per camera in their order.

    masks: read the silhouettes in masks_K/ too (white is the hand), which have the pictures' numbers.

    A view that is missing or of another size than its camera is left out with a warning; its reason stands in every
    frame. Raises InputError where no view is left, and where there are no masks at all although they are asked for.
    """
    folder = expanded(folder)
    paths = view_paths(folder, [camera.name for camera in cameras])
    if not any(paths):
        raise InputError(
            f"{folder}: no pictures of any camera; expected view_0, view_1, ... or a folder or video named after each"
            f" of {', '.join(camera.name for camera in cameras)}"
        )
    views = [
        open_view(camera.name, path, (camera.width, camera.height)) for camera, path in zip(cameras, paths, strict=True)
    ]
    if not masks:
        return RigSource(views, offsets=offsets, start=start, max_frames=max_frames)
    places = mask_paths(folder, len(cameras))
    if not any(places):
        raise InputError(f"{folder}: expected silhouettes in masks_0, masks_1, ..., found none")
    pairs = zip(cameras, places, strict=True)
    views += [open_view(f"{camera.name} mask", path, (camera.width, camera.height)) for camera, path in pairs]
    own = dict(offsets or {})
    own |= {f"{name} mask": frames for name, frames in own.items()}
    return RigSource(views, offsets=own, start=start, max_frames=max_frames, mask_views=len(cameras))


def open_uncalibrated(
    folder: str | Path, *, offsets: Offsets | None = None, every: int = 1, max_frames: int | None = None
) -> RigSource:
    """The recording of cameras that are not known yet: all views of a folder (see `find_views`), or one video."""
    folder = expanded(folder)
    found = {folder.stem: folder} if folder.is_file() else find_views(folder)
    views = [open_view(name, path) for name, path in found.items()]
    return RigSource(views, offsets=offsets, every=every, max_frames=max_frames, keep_all=True)


def offsets_of(texts: Sequence[str]) -> dict[str, int | float]:
    """Offsets written as NAME=FRAMES or NAME=SECONDSs. Raises InputError naming the text that is none."""
    offsets: dict[str, int | float] = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        match = _OFFSET.fullmatch(number)
        if not name or match is None:
            raise InputError(f"offset: expected NAME=FRAMES such as cam1=-3, or seconds as cam1=0.12s, got {text!r}")
        offsets[name] = float(number[:-1]) if match["seconds"] else int(number)
    return offsets


def _offsets(names: Sequence[str], offsets: Offsets) -> list[int | float]:
    for name in offsets:
        if name not in names:
            raise InputError(f"offset: {name!r} is no camera{suggestion(name, names)}; allowed: {', '.join(names)}")
    return [offsets.get(name, 0) for name in names]
