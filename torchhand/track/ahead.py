"""A tracker of recorded views that another process works for: it makes the silhouettes and the hull of the next frame,
and gathers what the views of the last one bear out of the fingers."""

import contextlib
import pickle
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.cluster import can_copy_process, usable_cores
from torchhand.devices import is_host
from torchhand.hand import HandPose
from torchhand.track.knowledge import Estimate, TrackerState
from torchhand.track.messages import READY, OtherProcess, answering, served
from torchhand.track.multiview import Hull
from torchhand.track.quality import Told
from torchhand.track.scene import Appearances, PackedMask, PlacedHand, View
from torchhand.track.tracker import Foreseen, Tracker

_MIN_FRAMES = 100  # in the seconds that a new process takes to begin, some 60 are done without it
_MIN_FRAMES_OF_COPY = 5
_BYTES_PER_PX = 4  # of a picture and of a mask
_IN_MEMORY = 3  # frames whose pictures both processes see: the last, whose fingers are judged, this one and the next

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
class _SceneOrder:
    """A scene that is to be made."""

    memory: str
    """Name of the shared memory."""
    pictures: tuple[tuple[_Picture | None, _Picture | None], ...]
    """Image and mask of every view."""
    appearance: Appearances
    time_s: float
    expected: Float[Tensor, "3"]


@dataclass(frozen=True, kw_only=True)
class _FingersOrder:
    """A hand whose fingers are to be judged by the views of a frame whose scene was made."""

    time_s: float
    pose: HandPose
    placed: PlacedHand
    shape: Float[Tensor, "shape"]


@dataclass(frozen=True, kw_only=True)
class _MadeScene:
    """What was made of an order."""

    appearance: Appearances
    masks: tuple[PackedMask | None, ...]
    hull: Hull | None


@dataclass(frozen=True, kw_only=True)
class _Fingers:
    """What the views of a frame bear out of a hand's fingers."""

    time_s: float
    borne_out: Float[Tensor, "5 4"]


class ScenesAhead:
    """Steps of a tracker that know the frame after theirs: its scene is made in another process meanwhile, and the
    evidence for the fingers of the frame before.

    The scene is what does not depend on the hand that is still to be found: the silhouettes, and the hull about the
    place where the hand was expected (`TrackerState.expected`). The evidence is what no later step depends on. The
    tracker alone would make the very same: results are the same, bit for bit, whether the other process is there, late
    or not yet begun. A context manager.
    """

    def __init__(self, make: Callable[[], Tracker], tracker: Tracker) -> None:
        """make: makes a tracker like `tracker` in the other process; picklable, such as a `functools.partial`."""
        self._tracker = tracker
        self._process = OtherProcess(serve, make, "makes scenes", is_copy=can_copy_process(tracker.device))
        self._memory: SharedMemory | None = None
        self._place = 0
        self._is_ready = False
        self._ordered: Frame | None = None
        self._made: deque[_MadeScene] = deque()
        self._is_behind = False
        self._fingers: dict[float, Tensor] = {}

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
    ) -> tuple[TrackerState, Estimate, Callable[[], Estimate]]:
        """`Tracker.step`, with an estimate that may lack the evidence of its fingers, and what gives the whole one.

        following: the frame that comes next, None where nothing is known of it; its keypoints may still be missing.
        What gives the whole estimate waits for the other process: it is to be called after the next step.
        Raises RuntimeError where the other process has failed, InputError where it was ended from outside.
        """
        foreseen = self._delivered((views, time_s))
        if following is not None and state is not None:
            self._order(state, time_s, following)
        sent: list[Told] = []

        def judges(told: Told) -> bool:
            """Whether the other process gathers it; not where this one had to wait for it, which has less to do."""
            if foreseen is None or told.placed is None or self._is_behind:
                return False
            order = _FingersOrder(time_s=time_s, pose=told.pose, placed=told.placed, shape=told.shape)
            self._process.send(order)
            sent.append(told)
            return True

        state, estimate = self._tracker.step(state, views, time_s, foreseen=foreseen, judges=judges)
        if not sent:
            return state, estimate, lambda: estimate
        return state, estimate, lambda: self._tracker.with_qualities(estimate, sent[0], self._judged(time_s))

    def _judged(self, time_s: float) -> Float[Tensor, "5 4"]:
        """What the views bear out of the fingers of a hand that was to be judged."""
        while time_s not in self._fingers:
            self._receive()
        return self._fingers.pop(time_s)

    def _receive(self) -> None:
        message = self._process.received()
        if isinstance(message, _Fingers):
            self._fingers[message.time_s] = message.borne_out
        else:
            assert isinstance(message, _MadeScene)
            self._made.append(message)

    def _order(self, state: TrackerState, time_s: float, following: Frame) -> None:
        """Have the scene of the next frame made, where the other process is there and a hand is followed."""
        views, next_s = following
        expected = self._tracker.expected(state, time_s)
        if expected is None or not self._has_begun():
            return
        pictures = self._shared(views)
        if pictures is None or self._memory is None:
            return
        order = _SceneOrder(
            memory=self._memory.name,
            pictures=pictures,
            appearance=state.appearance,
            time_s=next_s,
            expected=expected,
        )
        self._process.send(order)
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
        while self._process.connection.poll():
            self._receive()
        self._is_behind = not self._made
        while not self._made:
            self._receive()
        found = self._made.popleft()
        is_same = time_s == frame[1] and len(views) == len(frame[0])
        if not is_same or not all(map(_shows_the_same, views, frame[0])):
            return None
        masks = tuple(None if mask is None else mask.mask() for mask in found.masks)
        return Foreseen(appearance=found.appearance, masks=masks, hull=found.hull)

    def _shared(self, views: Sequence[View]) -> tuple[tuple[_Picture | None, _Picture | None], ...] | None:
        """The views' pictures, copied to the shared memory; None where there is none, they lie on a device or are not
        of the cameras' size."""
        given = [(view.image, view.mask) for view in views]
        known = [one for pair in given for one in pair if one is not None]
        room = sum(_BYTES_PER_PX * camera.width * camera.height for camera in self._tracker.cameras)
        is_at_home = all(is_host(one.device) for one in known)
        if not known or not is_at_home or sum(one.numel() for one in known) > room:
            return None
        if self._memory is None:
            self._memory = SharedMemory(create=True, size=_IN_MEMORY * room)
        # Orders are answered in turn: the scene of the frame before this one was made after the fingers were judged of
        # that whose pictures this writes over.
        self._place = (self._place + 1) % _IN_MEMORY
        start, found = self._place * room, []
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
    """Make scenes and judge fingers until nobody is at the other end (`served`). make: a pickled function that makes
    the tracker."""

    def work(tracker: Tracker) -> None:
        memory: SharedMemory | None = None
        last: deque[tuple[float, Foreseen]] = deque(maxlen=_IN_MEMORY - 1)
        with answering(connection) as answer:
            while True:
                order = pickle.loads(connection.recv_bytes())
                if isinstance(order, _FingersOrder):
                    answer(_judged(tracker, order, dict(last)[order.time_s]))
                    continue
                memory = memory or SharedMemory(name=order.memory)
                made = _made(tracker, order, memory)
                last.append((order.time_s, made))
                masks = tuple(None if mask is None else PackedMask.of(mask) for mask in made.masks)
                answer(_MadeScene(appearance=made.appearance, masks=masks, hull=made.hull))

    served(connection, make, work)


def _made(tracker: Tracker, order: _SceneOrder, memory: SharedMemory) -> Foreseen:
    parts = [[None if one is None else one.in_memory(memory) for one in pair] for pair in order.pictures]
    views = [View(image=image, mask=mask) for image, mask in parts]
    return tracker.foresee(order.appearance, views, order.time_s, order.expected)


def _judged(tracker: Tracker, order: _FingersOrder, foreseen: Foreseen) -> _Fingers:
    found = tracker.borne_out(order.pose, order.placed, order.shape, foreseen, order.time_s)
    return _Fingers(time_s=order.time_s, borne_out=found)


@contextlib.contextmanager
def scenes_ahead(
    make: Callable[[], Tracker], tracker: Tracker, frames: int | None = None
) -> Iterator[ScenesAhead | None]:
    """`ScenesAhead` of a tracker; None where there is no second core, where the tracker is of another kind, and for few
    frames.

    make: makes such a tracker; picklable. frames: how many come, None where nobody knows.
    """
    fewest = _MIN_FRAMES_OF_COPY if can_copy_process(tracker.device) else _MIN_FRAMES
    is_long = frames is None or frames >= fewest
    if not is_long or usable_cores() < 2 or tracker.parts.fitter is None or not is_host(tracker.device):
        yield None
        return
    with ScenesAhead(make, tracker) as ahead:
        yield ahead
