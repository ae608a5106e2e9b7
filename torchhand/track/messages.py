"""Processes that work for a tracker, each with a tracker of its own, and what they tell each other."""

import contextlib
import io
import os
import pickle
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from torchhand.cluster import begin_as_copy, without_threads_of_opencv
from torchhand.devices import HOST, is_host, sent_to
from torchhand.errors import InputError
from torchhand.track.scene import View

READY = "ready"
"""Says that a process has its tracker: work may be asked for."""


_AS_ARRAYS = (torch.uint8, torch.bool, torch.int16, torch.int32, torch.int64, torch.float32, torch.float64)


@dataclass(frozen=True, kw_only=True)
class SeenFrame:
    """The views of one time. By itself a message: follow a hand that was found to here."""

    time_s: float
    views: tuple[View, ...]
    """In the processor's memory."""

    @staticmethod
    def of(views: Sequence[View], time_s: float) -> "SeenFrame":
        return SeenFrame(time_s=time_s, views=tuple(sent_to(view, HOST) for view in views))

    @property
    def bytes(self) -> int:
        """Memory of the pictures."""
        pictures = (picture for view in self.views for picture in (view.image, view.mask) if picture is not None)
        return sum(picture.nbytes for picture in pictures)


@dataclass(frozen=True, kw_only=True)
class Search:
    """A frame in which other hands are to be looked for."""

    number: int
    frame: SeenFrame
    state: Mapping[str, Any] | None
    """What the tracker knew before the frame (`saved_state`); None at the first."""


@dataclass(frozen=True, kw_only=True)
class Reshape:
    """Frames of a hand that is followed, to which its proportions are to be fitted."""

    number: int
    state: Mapping[str, Any]
    """What the tracker knew after the last of them (`saved_state`)."""


Request = Search | Reshape


@dataclass(frozen=True, kw_only=True)
class Answer:
    """How a request ended."""

    number: int
    """Number of the request."""
    seconds: float
    """Time that it took, without that of the way to the newest picture."""
    state: Mapping[str, Any] | None
    """Of a search, what is known of a hand that explains more, at the last frame there was; None where none does. Else
    the state with its new proportions."""
    reason: str = ""
    """Why a search has found no hand."""


def packed(message: Any) -> bytes:
    """A message as bytes: tensors by their values, in no memory that processes share."""
    buffer = io.BytesIO()
    _Pickler(buffer, protocol=pickle.HIGHEST_PROTOCOL).dump(message)
    return buffer.getvalue()


class _Pickler(pickle.Pickler):
    """Tensors as arrays: a sixth of the time that torch takes for them."""

    def reducer_override(self, obj: Any) -> Any:
        """How an object is made again."""
        is_array = type(obj) is Tensor and is_host(obj.device) and not obj.requires_grad and obj.dtype in _AS_ARRAYS
        return (torch.from_numpy, (obj.numpy(),)) if is_array else NotImplemented


class OtherProcess:
    """A process that works for a tracker, and the connection to it."""

    def __init__(
        self, serve: Callable[[Connection, bytes], None], make: Callable[[], Any], does: str, *, is_copy: bool = False
    ) -> None:
        """serve: what it runs (`served`). make: makes its tracker; picklable. does: what it does, for errors.

        is_copy: whether it begins as a copy of this one, which takes no time, in place of a new one, which takes
        seconds; where `can_copy_process` says so, and no other threads are at work.
        """
        context = get_context("fork") if is_copy else get_context("spawn")
        self.connection, self._theirs = context.Pipe()
        given = (self._theirs, packed(make))
        target, args = (_in_copy, (self.connection, os.getpid(), serve, *given)) if is_copy else (serve, given)
        self._process = context.Process(target=target, args=args, name=does, daemon=True)
        self._does, self._is_copy = does, is_copy

    def start(self) -> None:
        """Let it begin."""
        if self._is_copy:
            resource_tracker.ensure_running()  # of shared memory: else a copy begins one of its own
        with without_threads_of_opencv() if self._is_copy else _without_main():
            self._process.start()
        self._theirs.close()

    def kill(self) -> None:
        """End it at once: it has nothing to keep."""
        self._process.kill()
        self._process.join()

    def send(self, message: Any) -> None:
        """Tell it something. Raises as `received`."""
        try:
            self.connection.send_bytes(packed(message))
        except OSError:
            while True:  # up to what it said last, or that it is gone
                self.received()

    def received(self) -> Any:
        """The next message, once there is one.

        Raises RuntimeError where the process has failed, and InputError where it was ended from outside.
        """
        try:
            message = pickle.loads(self.connection.recv_bytes())
        except (EOFError, OSError) as error:
            self._process.join()
            code = self._process.exitcode or 0
            if code < 0:
                told = f"the process that {self._does} was ended from outside, perhaps for want of memory"
                raise InputError(f"{told} (signal {-code})") from error
            raise RuntimeError(f"the process that {self._does} ended (exit code {code})") from error
        if isinstance(message, Exception):
            raise message
        return message


def _in_copy(
    other_end: Connection,
    parent: int,
    serve: Callable[[Connection, bytes], None],
    connection: Connection,
    make: bytes,
) -> None:
    begin_as_copy(parent)
    other_end.close()
    serve(connection, make)


def served(connection: Connection, make: bytes, work: Callable[[Any], None]) -> None:
    """What another process does until nobody is at the other end.

    make: a pickled function that makes its tracker. work: what is done with it, until it returns. Answers with the text
    of an error in place of a result where one occurs, and ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the tracker's to see
    torch.set_num_threads(1)
    try:
        tracker = pickle.loads(make)()
        connection.send_bytes(packed(READY))
        work(tracker)
    except (BrokenPipeError, ConnectionResetError, EOFError):
        return
    except Exception:
        connection.send_bytes(packed(RuntimeError(traceback.format_exc())))


@contextlib.contextmanager
def answering(connection: Connection) -> Iterator[Callable[[Any], None]]:
    """What sends answers to a tracker without waiting until they are read.

    A tracker that sends an order meanwhile does not read: were both larger than what the connection holds, each would
    wait for the other for ever.
    """
    answers: queue.Queue[bytes | None] = queue.Queue()

    def send() -> None:
        with contextlib.suppress(OSError):  # nobody is at the other end: who reads orders sees it
            while (answer := answers.get()) is not None:
                connection.send_bytes(answer)

    sender = threading.Thread(target=send, name="answers", daemon=True)
    sender.start()
    try:
        yield lambda answer: answers.put(packed(answer))
    finally:
        answers.put(None)
        sender.join()


@contextlib.contextmanager
def _without_main() -> Iterator[None]:
    """Processes that begin here do not run the program's own script first, as others do: it tracks, too."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
