"""The process that searches: one request after the other, a hand that is found followed to the newest picture."""

import math
import os
import pickle
import threading
import time
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection

from torchhand.track.knowledge import TrackerState, restored_state, saved_state
from torchhand.track.messages import Answer, Request, Reshape, Search, SeenFrame, packed, served
from torchhand.track.proposals import OCCASIONS, Occasion
from torchhand.track.tracker import Tracker

FOLLOWING: tuple[Occasion, ...] = ("always", "detected")
"""Occasions of the sources that are quick enough for a frame."""

_NEAR: tuple[Occasion, ...] = (*FOLLOWING, "declining", "degraded")
_WIDE: tuple[Occasion, ...] = (*FOLLOWING, "search")  # what takes more than a second, where the others bring nothing
_FIRST: tuple[Occasion, ...] = tuple(one for one in OCCASIONS if one != "patient")  # the hand may show itself meanwhile
_STEP_S = 0.1
"""From one picture to the next on the way to the newest: a hand that moves at half a metre a second, as people's do who
show something, goes half its breadth in it."""
_SHORT_STEPS = 3
"""Steps to the very next picture before those: of a hand that was just found no motion is known. Found in every twelfth
frame of `open_hand_wave` and followed for 0.8 s, 10 hands of 12 are kept with them, 3 without."""
_CATCHING_UP = 2.0  # how much faster pictures are passed than they come
_NICENESS = 5  # where there are too few cores, pictures go first
_KEPT_BYTES = 2**28  # of pictures that wait until a search has ended


class Inbox:
    """Messages as they come, read in a thread of its own: the tracker never waits for a search."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._changed = connection, threading.Condition()
        self._request: Request | None = None
        self._later: deque[SeenFrame] = deque()
        self._is_closed = False
        threading.Thread(target=self._read, name="messages", daemon=True).start()

    def next_request(self) -> Request | None:
        """The next request, once there is one; None where nobody is left to make any."""
        with self._changed:
            self._changed.wait_for(lambda: self._request is not None or self._is_closed)
            found, self._request = self._request, None
            return found

    def later_frame(self, time_s: float, step_s: float) -> tuple[SeenFrame, bool] | None:
        """The last frame that is not more than a step after a time, else the first after it, and whether it is the
        newest; None where there is none. Those before it are dropped."""
        with self._changed:
            found = None
            while self._later and (found is None or self._later[0].time_s <= time_s + step_s):
                found = self._later.popleft()
            return None if found is None else (found, not self._later)

    def _read(self) -> None:
        try:
            while True:
                self._take(pickle.loads(self._connection.recv_bytes()))
        except (EOFError, OSError):
            with self._changed:
                self._is_closed = True
                self._changed.notify_all()

    def _take(self, message: Request | SeenFrame) -> None:
        with self._changed:
            if not isinstance(message, SeenFrame):
                self._request = message
                self._later.clear()
                self._changed.notify_all()
                return
            self._later.append(message)
            if len(self._later) * message.bytes > _KEPT_BYTES:
                self._later = deque(list(self._later)[1::2])


class Searcher:
    """Searches as the tracker itself does where pictures wait, and follows what it found to the newest picture."""

    def __init__(self, tracker: Tracker, later_frame: Callable[[float, float], tuple[SeenFrame, bool] | None]) -> None:
        """later_frame: the frame to follow to from a time, about a step later (`Inbox.later_frame`)."""
        self._tracker, self._later_frame = tracker, later_frame

    def __call__(self, request: Request) -> Answer:
        """What comes of a request."""
        return self._reshaped(request) if isinstance(request, Reshape) else self._searched(request)

    def _reshaped(self, request: Reshape) -> Answer:
        begun_s = time.monotonic()
        state = self._tracker.reshaped(restored_state(request.state, self._tracker.device))
        return Answer(number=request.number, seconds=time.monotonic() - begun_s, state=saved_state(state))

    def _searched(self, search: Search) -> Answer:
        begun_s, frame = time.monotonic(), search.frame
        before = None if search.state is None else restored_state(search.state, self._tracker.device)
        has_started = before is not None and before.has_started
        is_detected = any(view.keypoints is not None for view in frame.views)
        for occasions in (_NEAR, _WIDE) if has_started or is_detected else (_FIRST,):
            state, estimate = self._tracker.step(before, frame.views, frame.time_s, occasions=occasions)
            if estimate.is_new:
                break
        seconds = time.monotonic() - begun_s
        found = self._followed(state, is_detected=is_detected) if estimate.is_new else None
        if found is None:
            reason = "a hand was found and lost again" if estimate.is_new else estimate.reason
            return Answer(number=search.number, seconds=seconds, state=None, reason=reason)
        return Answer(number=search.number, seconds=seconds, state=saved_state(found))

    def _followed(self, state: TrackerState, *, is_detected: bool) -> TrackerState | None:
        """The state at the newest frame; None where the hand is given up on the way. is_detected: whether a detector
        tells of the hand, so that it needs no way."""
        step_s, is_newest, steps = math.inf if is_detected else 0.0, False, 0
        assert state.time_s is not None
        while not is_newest and (later := self._later_frame(state.time_s, step_s)) is not None:
            (frame, is_newest), begun_s, steps = later, time.monotonic(), steps + 1
            state, _ = self._tracker.step(state, frame.views, frame.time_s, occasions=FOLLOWING)
            if state.hand is None:
                return None
            if steps >= _SHORT_STEPS:
                step_s = max(_STEP_S, _CATCHING_UP * (time.monotonic() - begun_s))
            assert state.time_s is not None
        return state


def serve(connection: Connection, make: bytes) -> None:
    """Search until nobody is at the other end (`served`). make: a pickled function that makes the tracker."""
    if hasattr(os, "nice"):
        os.nice(_NICENESS)

    def work(tracker: Tracker) -> None:
        inbox = Inbox(connection)
        searcher = Searcher(tracker, inbox.later_frame)
        while (request := inbox.next_request()) is not None:
            connection.send_bytes(packed(searcher(request)))

    served(connection, make, work)
