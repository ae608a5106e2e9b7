"""A tracker that searches in another process: a step takes as long as a hand is followed."""

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from types import TracebackType

from torchhand.cluster import can_copy_process
from torchhand.track.knowledge import Estimate, TrackerState, restored_state, saved_state
from torchhand.track.messages import READY, Answer, OtherProcess, Request, Reshape, Search, SeenFrame, packed
from torchhand.track.scene import View
from torchhand.track.tracker import Tracker
from torchhand.track.worker import FOLLOWING, serve

_log = logging.getLogger(__name__)

STILL_SEARCHED = "the first search for a hand has not ended"
"""Reason of frames without a hand until a search tells one."""
_SENT_EVERY_S = 0.09  # from one picture that is sent for a search that goes on to the next: hardly less than its steps
_ALL_SENT_S = 0.15  # after the searched frame in which every picture is sent: in these the hand's motion becomes known


class SearchBeside:
    """Steps of a tracker that never search and never fit proportions: another process does both. Of any cameras.

    That process has a tracker of its own. It is given what was known before a frame that left the hand in doubt, does
    with the frame what `Tracker.step` does, follows what it finds through the pictures that have come meanwhile, and
    hands it over at the newest: there the two hands are compared as any are. One search goes on at a time. While a
    hand is followed, the next one begins as long after one in vain as that one took, so that half of a core is spent.
    Proportions, which frames tell ever more finely, are fitted there between two searches, and used at once.

    A process, for a thread would have the interpreter's lock in common with the tracker: two trackers of one camera
    take 31 to 39 ms a frame each in two processes on two idle cores, 32 to 36 ms alone, 62 to 87 ms in two threads.

    It begins as a copy of this process, at once, where that can be (`can_copy_process`) and no thread but the caller's
    is at work when this object is made; else it begins by itself, which takes seconds.

    Results depend on when searches end: for pictures that do not wait, not for recordings. A context manager.
    """

    def __init__(self, make: Callable[[], Tracker]) -> None:
        """make: makes the tracker, here and in the other process; picklable, such as a `functools.partial`."""
        self.tracker = make()
        is_copy = can_copy_process(self.tracker.device) and threading.active_count() == 1
        self._process = OtherProcess(serve, make, "searches", is_copy=is_copy)
        self._messages: queue.Queue[Request | SeenFrame | None] = queue.Queue()
        self._sender = threading.Thread(target=self._send, name="searches", daemon=True)
        self._number, self._is_ready = 0, False
        self._asked: Request | None = None
        """The request that goes on."""
        self._sent_s, self._rest_until_s = 0.0, 0.0
        self._reason = STILL_SEARCHED

    def __enter__(self) -> "SearchBeside":
        self._process.start()
        self._sender.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._messages.put(None)
        self._process.kill()
        self._sender.join()
        self._process.connection.close()

    @property
    def is_ready(self) -> bool:
        """Whether the other process was heard from: it has begun, and looks for hands."""
        return self._is_ready

    def step(self, state: TrackerState | None, views: Sequence[View], time_s: float) -> tuple[TrackerState, Estimate]:
        """`Tracker.step` without searches and fits; state None forgets what goes on there as well.

        Raises RuntimeError where the other process has failed, InputError where it was ended from outside.
        """
        if state is None:
            self._number += 1
            self._reason = STILL_SEARCHED
        state, other = self._answered(state)
        if other is not None and (state is None or not state.has_started):
            state, other = other, None
        after, estimate = self.tracker.step(state, views, time_s, occasions=FOLLOWING, other=other)
        if not after.has_started:
            estimate = replace(estimate, reason=self._reason)
        self._offer(state, after, views, estimate)
        return after, estimate

    def _answered(self, state: TrackerState | None) -> tuple[TrackerState | None, TrackerState | None]:
        """The state with the proportions that were fitted meanwhile; and what was known of a hand that the last search
        has found, at one of the last frames, None where there is nothing new."""
        found = None
        while self._process.connection.poll():
            answer = self._process.received()
            if answer == READY:
                self._is_ready = True
                continue
            assert isinstance(answer, Answer)
            asked, self._asked = self._asked, None
            known = None
            if answer.state is not None and answer.number == self._number:  # else it was forgotten meanwhile
                known = restored_state(answer.state, self.tracker.device)
            if isinstance(asked, Reshape):
                _log.debug("proportions %d: fitted after %.2f s", answer.number, answer.seconds)
                state = state if known is None or state is None else _reshaped(state, known, asked)
                continue
            told = "no other hand" if known is None else f"a hand at {known.time_s:.2f} s"
            _log.debug("search %d: %s after %.2f s", answer.number, told, answer.seconds)
            self._rest_until_s = time.monotonic() + answer.seconds
            if known is None and answer.number == self._number:
                self._reason = answer.reason
            found = found if known is None else known
        return state, found

    def _offer(
        self, before: TrackerState | None, after: TrackerState, views: Sequence[View], estimate: Estimate
    ) -> None:
        """A frame that was tracked: for the search that goes on, or for what is due."""
        if isinstance(self._asked, Search):
            is_near = estimate.time_s <= self._asked.frame.time_s + _ALL_SENT_S
            if is_near or estimate.time_s >= self._sent_s + _SENT_EVERY_S:
                self._messages.put(SeenFrame.of(views, estimate.time_s))
                self._sent_s = estimate.time_s
        if self._asked is not None or not self.is_ready:
            return
        is_resting = estimate.pose is not None and time.monotonic() < self._rest_until_s
        if self.tracker.is_reshape_due(after):
            self._ask(Reshape(number=self._number + 1, state=saved_state(after)), estimate.time_s)
        elif estimate.is_doubted and not is_resting:
            is_found = before is not None and before.has_started  # then nothing but its hand is taken over
            state = None if before is None else saved_state(replace(before, shape_frames=None) if is_found else before)
            frame = SeenFrame.of(views, estimate.time_s)
            self._ask(Search(number=self._number + 1, frame=frame, state=state), estimate.time_s)

    def _ask(self, request: Request, time_s: float) -> None:
        _log.debug("%s %d begins at %.2f s", type(request).__name__.lower(), request.number, time_s)
        self._number, self._asked, self._sent_s = request.number, request, time_s
        self._messages.put(request)

    def _send(self) -> None:
        with contextlib.suppress(OSError):  # nobody is there any more: who reads answers says so
            while (message := self._messages.get()) is not None:
                self._process.connection.send_bytes(packed(message))


def _reshaped(state: TrackerState, fitted: TrackerState, asked: Reshape) -> TrackerState:
    """A state with the proportions that were fitted to the frames it had when that was asked; it may have more now."""
    sent = len(asked.state["shape_frames"])
    frames = None
    if fitted.shape_frames is not None and state.shape_frames is not None:
        frames = (*fitted.shape_frames, *state.shape_frames[sent:])
    return replace(state, shape=fitted.shape, shape_frames=frames, shape_fitted_to=fitted.shape_fitted_to)


@contextlib.contextmanager
def opened_tracker(make: Callable[[], Tracker], *, waits: bool) -> Iterator[tuple[Tracker, SearchBeside | None]]:
    """A tracker, and what searches for it where pictures do not wait. make: makes it; picklable."""
    if waits:
        yield make(), None
        return
    with SearchBeside(make) as beside:
        yield beside.tracker, beside
