"""What a source of pictures is to those who read it: one `Frame` after the other, whatever it comes from."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType

from jaxtyping import UInt8
from torch import Tensor

from torchhand.errors import InputError

ASSUMED_FPS = 30.0
"""Frames per second of folders of pictures, and where the container's number cannot be true."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One picture of a sequence, or the reason why there is none."""

    index: int
    """Place in the source, counted from 0 at its very first frame (also when reading starts later)."""
    time_s: float
    """When it is shown, or was taken, since the very first frame; greater than that of the frame before."""
    image: UInt8[Tensor, "height width 3"] | None
    """The picture, RGB; None where the frame could not be decoded."""
    problem: str | None = None
    """One line for the user where `image` is None."""


@dataclass(frozen=True, kw_only=True)
class FrameRange:
    """Which frames of a source are wanted: `max_frames` of them from `start`, without the first `already_done`."""

    start: int = 0
    max_frames: int | None = None
    """Number of frames at most; None: to the end."""
    already_done: int = 0
    """Frames of the range that an earlier run has finished; it is no error when none remain."""

    def __post_init__(self) -> None:
        if self.start < 0:
            raise InputError(f"start: expected a frame number of 0 or more, got {self.start}")
        if self.max_frames is not None and self.max_frames < 1:
            raise InputError(f"max_frames: expected 1 or more, got {self.max_frames}")
        if self.already_done < 0:
            raise ValueError(f"already_done: expected 0 or more, got {self.already_done}")

    @property
    def first(self) -> int:
        """Index of the first frame to deliver."""
        return self.start + self.already_done

    @property
    def end(self) -> int | None:
        """Index after the last frame to deliver; None: no limit."""
        return None if self.max_frames is None else self.start + self.max_frames

    def holds(self, index: int) -> bool:
        """Whether the frame of this index is to be delivered."""
        return self.first <= index and (self.end is None or index < self.end)

    def within(self, total: int | None) -> int | None:
        """How many frames will be delivered of a source that holds `total`; None where nobody knows."""
        ends = [end for end in (self.end, total) if end is not None]
        return max(0, min(ends) - self.first) if ends else None


class FrameSource(ABC):
    """A sequence of pictures of one size, read once and in order, holding one picture at a time.

    A context manager and an iterator of `Frame`; `width` and `height` are known as soon as it is open.
    """

    name: str
    """Name of the sequence, fit for a folder name."""
    fps: float
    """Frames per second, the mean where the rate varies; `ASSUMED_FPS` where the container lies or says nothing."""
    count: int | None
    """How many frames this reading will deliver, for a progress bar; containers lie, so nothing else may rely on it."""
    width: int
    """Width of the pictures, px."""
    height: int
    """Height of the pictures, px."""
    ended_early: str | None = None
    """After the last frame: one line for the user if the container had promised more frames than could be read."""

    @abstractmethod
    def __iter__(self) -> Iterator[Frame]:
        """The frames; a second iteration of the same source raises ValueError.

        Raises InputError where a picture has another size than the first, or where the range starts after the end.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of files and devices; may be called twice."""

    def __enter__(self) -> "FrameSource":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def check_size(what: str, image: UInt8[Tensor, "height width 3"], *, width: int, height: int) -> None:
    """Raise InputError where a picture has not the size of the first one."""
    if tuple(image.shape[:2]) != (height, width):
        raise InputError(
            f"{what}: expected a picture of {width}x{height} px like the first, got {image.shape[1]}x{image.shape[0]}"
        )
