"""A tracker of recorded views whose next silhouettes and hull are made in another process meanwhile."""

import contextlib
import logging
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import is_host
from torchhand.track.knowledge import Estimate, TrackerState
from torchhand.track.messages import READY, OtherProcess, packed, served
from torchhand.track.multiview import Hull
from torchhand.track.scene import Appearances, PackedMask, View
from torchhand.track.tracker import Foreseen, Tracker

_log = logging.getLogger(__name__)

_MIN_FRAMES = 100  # in the seconds that the other process takes to begin, some 60 are done without it

Frame = tuple[Sequence[View], float]
"""The views of one time, and that time in seconds."""


@dataclass(frozen=True, kw_only=True)
class _Picture:
    """Where a picture or a mask lies in the memory that both processes share."""

    start: int
    shape: tuple[int, ...]
    dtype: torch.dtype

    @property
    def bytes(self) -> int:
        return torch.Size(self.shape).numel()

    def in_memory(self, memory: SharedMemory) -> Tensor:
        """The picture itself, nothing of it copied."""
        flat = torch.frombuffer(memory.buf, dtype=self.dtype, count=self.bytes, offset=self.start)
        return flat.reshape(self.shape)


@dataclass(frozen=True, kw_only=True)
class _Order:
    """A scene that is to be made."""

    memory: str
    """Name of the shared memory."""
    pictures: tuple[tuple[_Picture | None, _Picture | None], ...]
    """Image and mask of every view."""
    appearance: Appearances
    time_s: float
    expected: Float[Tensor, "3"]


@dataclass(frozen=True, kw_only=True)
class _Delivery:
    """What was made of an order."""

    appearance: Appearances
    masks: tuple[PackedMask | None, ...]
    hull: Hull | None


class ScenesAhead:
    """Steps of a tracker that know the frame after theirs: its scene is made in another process meanwhile.

    That is what does not depend on the hand that is still to be found: the silhouettes, and the hull about the place
    where the hand was expected (`TrackerState.expected`). The tracker alone would make the very same: results are the
    same, bit for bit, whether the other process is there, late or not yet begun. A context manager.
    """

    def __init__(self, make: Callable[[], Tracker], tracker: Tracker) -> None:
        """make: makes a tracker like `tracker` in the other process; picklable, such as a `functools.partial`."""
        self._tracker = tracker
        self._process = OtherProcess(serve, make, "makes scenes")
        self._memory: SharedMemory | None = None
        self._is_ready = False
        self._ordered: Frame | None = None

    def __enter__(self) -> "ScenesAhead":
        self._process.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.connection.close()
        if self._memory is not None:
            self._memory.close()
            self._memory.unlink()

    def wait(self) -> None:
        """Until the other process has begun; without it, the first frames are done here alone."""
        if not self._is_ready:
            self._is_ready = self._process.received() == READY

    def step(
        self, state: TrackerState | None, views: Sequence[View], time_s: float, following: Frame | None = None
    ) -> tuple[TrackerState, Estimate]:
        """`Tracker.step`. following: the frame that comes next, None where nothing is known of it; its keypoints may
        still be missing.

        Raises RuntimeError where the other process has failed.
        """
        foreseen = self._delivered((views, time_s))
        if following is not None and state is not None:
            self._order(state, time_s, following)
        return self._tracker.step(state, views, time_s, foreseen=foreseen)

    def _order(self, state: TrackerState, time_s: float, following: Frame) -> None:
        """Have the scene of the next frame made, where the other process is there and a hand is followed."""
        views, next_s = following
        expected = self._tracker.expected(state, time_s)
        if expected is None or not self._has_begun():
            return
        pictures = self._shared(views)
        if pictures is None or self._memory is None:
            return
        order = _Order(
            memory=self._memory.name,
            pictures=pictures,
            appearance=state.appearance,
            time_s=next_s,
            expected=expected,
        )
        self._process.connection.send_bytes(packed(order))
        self._ordered = following

    def _has_begun(self) -> bool:
        if not self._is_ready and self._process.connection.poll():
            self._is_ready = self._process.received() == READY
        return self._is_ready

    def _delivered(self, frame: Frame) -> Foreseen | None:
        """What was made of the last order; None where that was for another frame."""
        if self._ordered is None:
            return None
        (views, time_s), self._ordered = self._ordered, None
        found = self._process.received()
        assert isinstance(found, _Delivery)
        is_same = time_s == frame[1] and len(views) == len(frame[0])
        if not is_same or not all(map(_shows_the_same, views, frame[0])):
            return None
        masks = tuple(None if mask is None else mask.mask() for mask in found.masks)
        return Foreseen(appearance=found.appearance, masks=masks, hull=found.hull)

    def _shared(self, views: Sequence[View]) -> tuple[tuple[_Picture | None, _Picture | None], ...] | None:
        """The views' pictures, copied to the shared memory; None where there is none or they lie on a device."""
        given = [(view.image, view.mask) for view in views]
        known = [one for pair in given for one in pair if one is not None]
        if not known or not all(is_host(one.device) for one in known):
            return None
        size = sum(one.numel() for one in known)
        if self._memory is None or self._memory.size < size:
            if self._memory is not None:
                self._memory.close()
                self._memory.unlink()
            self._memory = SharedMemory(create=True, size=size)
        start, found = 0, []
        for pair in given:
            places: list[_Picture | None] = [None, None]
            for index, one in enumerate(pair):
                if one is not None:
                    places[index] = place = _Picture(start=start, shape=tuple(one.shape), dtype=one.dtype)
                    place.in_memory(self._memory).copy_(one)
                    start += place.bytes
            found.append((places[0], places[1]))
        return tuple(found)


def _shows_the_same(one: View, other: View) -> bool:
    return one.image is other.image and one.mask is other.mask


def serve(connection: Connection, make: bytes) -> None:
    """Make scenes until nobody is at the other end (`served`). make: a pickled function that makes the tracker."""

    def work(tracker: Tracker) -> None:
        memory: SharedMemory | None = None
        while True:
            order = pickle.loads(connection.recv_bytes())
            if memory is None or memory.name != order.memory:
                memory = SharedMemory(name=order.memory)
            connection.send_bytes(packed(_made(tracker, order, memory)))

    served(connection, make, work)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _made(tracker: Tracker, order: _Order, memory: SharedMemory) -> _Delivery:
    parts = [[None if one is None else one.in_memory(memory) for one in pair] for pair in order.pictures]
    views = [View(image=image, mask=mask) for image, mask in parts]
    found = tracker.foresee(order.appearance, views, order.time_s, order.expected)
    packed_masks = tuple(None if mask is None else PackedMask.of(mask) for mask in found.masks)
    return _Delivery(appearance=found.appearance, masks=packed_masks, hull=found.hull)


@contextlib.contextmanager
def scenes_ahead(
    make: Callable[[], Tracker], tracker: Tracker, frames: int | None = None
) -> Iterator[ScenesAhead | None]:
    """`ScenesAhead` of a tracker; None where there is no second core, where the tracker is of another kind, and for few
    frames.

    make: makes such a tracker; picklable. frames: how many come, None where nobody knows.
    """
    is_long = frames is None or frames >= _MIN_FRAMES
    if not is_long or _cores() < 2 or tracker.parts.fitter is None or not is_host(tracker.device):
        yield None
        return
    with ScenesAhead(make, tracker) as ahead:
        yield ahead
