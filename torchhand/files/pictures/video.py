"""Video files, addresses of streams and standard input, read in order by FFmpeg and never by seeking."""

import contextlib
import enum
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files.pictures.container import STANDARD_INPUT, UNORDERED, open_container, reason_of, shown_address
from torchhand.files.pictures.frame_source import ASSUMED_FPS, Frame, FrameRange, FrameSource, check_size
from torchhand.files.pictures.limits import size_problem

if TYPE_CHECKING:
    from av import Packet, VideoFrame, VideoStream
    from av.container import InputContainer

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg")

_PATIENCE = 300
"""Undecodable frames at the start after which a video holds none at all."""
_LARGEST_FPS = 1000.0
_LARGEST_COUNT = 10**8
_SLACK_S = 0.25
"""By which the pictures may end before the container does: its sound goes on for a few packets."""


@dataclass(frozen=True)
class _Decoded:
    """What came out of the decoder for one frame."""

    frame: "VideoFrame | None"
    """None where it could not be decoded."""
    pts: int | None
    """Presentation time in units of the stream; None where the container tells none."""


@dataclass(frozen=True)
class _Promise:
    """How long a video is by its container's own account."""

    count: int | None
    """Number of frames; None where nothing is told."""
    is_counted: bool = False
    """Whether the container counts its frames; else the number is that of its duration at the mean rate."""
    duration_s: float | None = None
    """From the first frame to the end, where the frames are not counted."""


class VideoSource(FrameSource):
    """Frames of a video, in the order in which they are shown, upright, at the times at which they are shown.

    Seeking trusts the container's index, which may be wrong; so the frames before the range are decoded and dropped.
    What cannot be decoded is a corrupt frame; the container's frame count is not asked. Times are those of the file,
    so a variable rate is kept; where they cannot be true, the rate is taken for constant.
    """

    def __init__(self, name: str, place: Path | str, frames: FrameRange) -> None:
        """place: a file, or (as texts) an address or `STANDARD_INPUT`. Raises InputError where it is no video."""
        self.name = name
        self._what = "standard input" if place == STANDARD_INPUT else shown_address(str(place))
        self._frames, self._used = frames, False
        self._container, self._stream = open_container(place)
        self.fps, unit_s = _rate_and_unit(self._stream)
        self._clock = _Clock(unit_s, 1 / self.fps)
        self._promise = _promised(self._container, self._stream, self.fps)
        self.count = frames.within(self._promise.count)
        self._network_problem: str | None = None
        self._decoded = self._in_order()
        # Everything up to the first good frame is read here, for its size, and handed out later.
        self._peeked: deque[_Decoded] = deque()
        for one in self._decoded:
            self._peeked.append(one)
            if one.frame is not None or len(self._peeked) > _PATIENCE:
                break
        first = self._peeked[-1].frame if self._peeked else None
        if first is None:
            self.close()
            reason = UNORDERED if isinstance(place, str) else "not a single frame can be decoded"
            raise InputError(f"{self._what}: {reason}")
        if problem := size_problem(first.width, first.height):
            self.close()
            raise InputError(f"{self._what}: {problem}")
        is_turned = _quarter_turns(first) % 2 == 1
        self.width, self.height = (first.height, first.width) if is_turned else (first.width, first.height)

    def __iter__(self) -> Iterator[Frame]:
        if self._used:
            raise ValueError("a source is read once; open it again")
        self._used = True
        wanted, index = self._frames, 0
        if wanted.within(None) == 0:
            return
        last_s = 0.0
        lost: list[tuple[int, float]] = []  # those at the very end are where the video breaks off
        for one in self._all():
            time_s = self._clock(one.pts)
            if one.frame is None:
                lost.append((index, time_s))
            else:
                for number, lost_s in lost:
                    if wanted.holds(number):
                        problem = f"{self._what}: frame {number} is corrupt"
                        yield Frame(index=number, time_s=lost_s, image=None, problem=problem)
                lost.clear()
                last_s = time_s
                if wanted.holds(index):
                    image = _upright_rgb(one.frame)
                    check_size(f"{self._what}, frame {index}", image, width=self.width, height=self.height)
                    yield Frame(index=index, time_s=time_s, image=image)
            index += 1
            if wanted.end is not None and index >= wanted.end and not lost:
                return
        self._report_end(index - len(lost), last_s)

    def close(self) -> None:
        self._container.close()

    def _report_end(self, total: int, last_s: float) -> None:
        """Called with the number of frames that the video turned out to hold, and the time of the last of them."""
        if total <= self._frames.start:
            raise InputError(f"{self._what}: start {self._frames.start} lies after the last frame ({total - 1})")
        promise = self._promise
        if promise.is_counted and promise.count is not None:
            if total < promise.count:
                why = f" ({self._network_problem})" if self._network_problem else ""
                self.ended_early = (
                    f"{self._what}: the container promises {promise.count} frames, {total} could be read{why}"
                )
        elif self._network_problem is not None:
            self.ended_early = f"{self._what}: ended after {total} frames ({self._network_problem})"
        elif promise.duration_s is not None and last_s + self._clock.longest_s + _SLACK_S < promise.duration_s:
            self.ended_early = (
                f"{self._what}: the container promises {promise.duration_s:.2f} s, "
                f"{total} frames could be read, the last at {last_s:.2f} s"
            )

    def _all(self) -> Iterator[_Decoded]:
        while self._peeked:
            yield self._peeked.popleft()
        yield from self._decoded

    def _in_order(self) -> Iterator[_Decoded]:
        """Frames as they are shown, with the undecodable ones in their places among them."""
        from av.error import FFmpegError

        failed: list[int | None] = []
        for packet in self._packets():
            try:
                frames = packet.decode() if packet is not None else self._stream.codec_context.decode(None)
            except FFmpegError:
                failed.append(packet.pts if packet is not None else None)
                continue
            for frame in frames:
                pts = frame.pts
                before = [one for one in failed if one is None or pts is None or one < pts]
                failed = [one for one in failed if one is not None and pts is not None and one >= pts]
                yield from (_Decoded(None, one) for one in before)
                yield _Decoded(frame, pts)
        yield from (_Decoded(None, one) for one in failed)

    def _packets(self) -> Iterator["Packet | None"]:
        """Packets as they come. None where they break off: the decoder is to give what it still holds."""
        from av.error import FFmpegError

        try:
            yield from self._container.demux(self._stream)
        except FFmpegError as error:  # what follows is not there, or cannot be told from other things
            self._network_problem = reason_of(error) if error.errno and error.errno > 0 else None
            yield None


class _Clock:
    """Times of frames since the first, which only grow."""

    def __init__(self, unit_s: float, step_s: float) -> None:
        """unit_s: of the presentation times, 0 where they are not to be believed. step_s: from frame to frame then."""
        self._unit_s, self._step_s = unit_s, step_s
        self._first: int | None = None
        self._count, self._last_s = 0, -1.0
        self.longest_s = step_s
        """Longest time between two frames so far."""

    def __call__(self, pts: int | None) -> float:
        """Of the next frame."""
        time_s = self._count * self._step_s if self._unit_s <= 0 else self._told(pts)
        if self._count == 0:
            time_s = 0.0
        elif time_s is None or time_s <= self._last_s:
            time_s = self._last_s + self._step_s
        if self._count > 0:
            self.longest_s = max(self.longest_s, time_s - self._last_s)
        self._count, self._last_s = self._count + 1, time_s
        return time_s

    def _told(self, pts: int | None) -> float | None:
        if pts is None:
            return None
        if self._first is None:  # after frames without a time
            self._first = pts - round(self._count * self._step_s / self._unit_s)
        return (pts - self._first) * self._unit_s


def video_times(path: Path) -> list[float] | None:
    """When each frame of a file is shown, seconds since the first, as `VideoSource` tells them; nothing is decoded.

    None where the container does not tell. Raises InputError where it is no video.
    """
    from av.error import FFmpegError

    container, stream = open_container(path)
    with container:
        fps, unit_s = _rate_and_unit(stream)
        stamps: list[int | None] = []
        with contextlib.suppress(FFmpegError):  # what follows is not there
            stamps += [packet.pts for packet in container.demux(stream) if packet.size and not packet.is_discard]
    known = sorted(stamp for stamp in stamps if stamp is not None)
    if unit_s <= 0 or not known or len(known) < len(stamps):
        return None
    clock = _Clock(unit_s, 1 / fps)
    return [clock(stamp) for stamp in known]


def _rate_and_unit(stream: "VideoStream") -> tuple[float, float]:
    """Mean frames per second, and the unit of the presentation times, s; 0 where those cannot be true."""
    rate = float(stream.average_rate or stream.guessed_rate or 0)
    is_credible = 0 < rate <= _LARGEST_FPS
    return (rate, float(stream.time_base or 0)) if is_credible else (ASSUMED_FPS, 0.0)


def _promised(container: "InputContainer", stream: "VideoStream", fps: float) -> _Promise:
    if 0 < stream.frames < _LARGEST_COUNT:
        return _Promise(stream.frames, is_counted=True)
    duration_s = 0.0
    if stream.duration and stream.time_base:
        duration_s = float(stream.duration * stream.time_base)
    elif container.duration:
        duration_s = container.duration / 1e6
        if stream.start_time is not None and stream.time_base and container.start_time is not None:
            duration_s -= max(0.0, float(stream.start_time * stream.time_base) - container.start_time / 1e6)
    count = round(duration_s * fps)
    return _Promise(count, is_counted=False, duration_s=duration_s) if 0 < count < _LARGEST_COUNT else _Promise(None)


def _quarter_turns(frame: "VideoFrame") -> int:
    """By which a picture is to be turned, counterclockwise."""
    return round(getattr(frame, "rotation", 0) / 90) % 4


def _upright_rgb(frame: "VideoFrame") -> UInt8[Tensor, "height width 3"]:
    """The picture as it is to be seen, in the matrix and range that it says it has."""
    from av.video.reformatter import ColorRange, Colorspace

    matrix = _name_of(Colorspace, int(frame.colorspace), "DEFAULT")
    rgb = frame.reformat(
        format="rgb24",
        src_colorspace=matrix,
        dst_colorspace=matrix,
        src_color_range=_name_of(ColorRange, int(frame.color_range), "UNSPECIFIED"),
        dst_color_range="JPEG",  # all of 0 to 255
        threads=1,  # more are started anew for every picture: 0.6 ms of 1280x720 become 3
    ).to_ndarray()
    turns = _quarter_turns(frame)
    return torch.from_numpy(np.ascontiguousarray(np.rot90(rgb, turns)) if turns else rgb)


def _name_of(kind: type[enum.Enum], value: int, other: str) -> str:
    """The name that this version of PyAV has for a value of FFmpeg's."""
    return next((member.name for member in kind if member.value == value), other)
