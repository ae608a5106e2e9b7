"""Work over processes of this machine that begin as copies of this one: what it has loaded and made, they have."""

import contextlib
import ctypes
import functools
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

import cv2
import torch

from torchhand.cluster.memory import keep_freed_memory
from torchhand.devices import is_host
from torchhand.errors import InputError

_PARENT_DEATH_SIGNAL = 1
"""PR_SET_PDEATHSIG of prctl(2)."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def can_copy_process(device: torch.device) -> bool:
    """Whether work on the device can go to copies of this process: on Linux, which makes them, and where this process
    has nothing on an accelerator, which copies could not use."""
    return sys.platform == "linux" and is_host(device) and not torch.cuda.is_initialized()


class Copies:
    """Copies of this process that work side by side, each with one of torch's threads and one of OpenCV's, so that the
    results do not depend on their number. They end with this process, however that ends."""

    def __init__(self, processes: int) -> None:
        self.processes = processes

    def done(
        self, make_work: Callable[[], Callable[[Item], Result]], items: Sequence[Item]
    ) -> Iterator[tuple[Item, Result]]:
        """Items with their results as they are done, in no order.

        make_work: makes, once in each process, the function that is called with its items; neither is pickled, items
        and results are. What they raise is raised here. Raises InputError where a process is lost. Where the caller
        goes on no further, as after Ctrl-C, what is at work is ended.
        """
        count = min(self.processes, len(items))
        if not count:
            return
        others = set(active_children())
        pool = ProcessPoolExecutor(
            count, mp_context=get_context("fork"), initializer=_begin, initargs=(make_work, os.getpid())
        )
        is_done, own = False, set[BaseProcess]()
        try:
            with without_threads_of_opencv():  # this makes all processes
                pool.submit(os.getpid)
            own = set(active_children()) - others
            yield from done_by(pool, _run, items, at_once=2 * count)
            is_done = True
        except BrokenProcessPool as error:
            raise InputError(
                "a process at work was ended from outside, perhaps for want of memory: ask for fewer of them"
            ) from error
        finally:
            for process in set() if is_done else own:
                process.kill()
            pool.shutdown(cancel_futures=True)


def copies_for(count: int, workers: int, device: torch.device) -> Copies | None:
    """Copies of this process for so many independent pieces of work, at most as many as workers; None where this one
    does them all: where only one is wanted, or none can be made."""
    processes = min(count, workers)
    return Copies(processes) if processes > 1 and can_copy_process(device) else None


def side_by_side(jobs: Sequence[Callable[[], Result]], device: torch.device) -> list[Result]:
    """The results of some jobs, in their order: side by side in copies of this process where these can be made and
    there are cores for them, else here, one after the other, to the same bits.

    Jobs change nothing here, and compute on one thread of torch's as the copies do; what they raise is raised here.
    device: that they compute on.
    """
    copies = copies_for(len(jobs), usable_cores(), device)
    if copies is None:
        return [job() for job in jobs]

    def work(place: int) -> bytes:
        return pickle.dumps(jobs[place](), pickle.HIGHEST_PROTOCOL)  # tensors by their values, for this process ends

    found = dict(copies.done(lambda: work, range(len(jobs))))
    return [pickle.loads(found[place]) for place in range(len(jobs))]


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def done_by(
    pool: Executor, work: Callable[[Item], Result], items: Sequence[Item], *, at_once: int
) -> Iterator[tuple[Item, Result]]:
    """Items with their results as a pool's workers are done with them, in no order; so many are out at a time."""
    waiting, running = iter(items), dict[Future[Result], Item]()
    while True:
        for item in waiting:
            running[pool.submit(work, item)] = item
            if len(running) >= at_once:
                break
        if not running:
            return
        for finished in wait(running, return_when=FIRST_COMPLETED).done:
            yield running.pop(finished), finished.result()


@contextlib.contextmanager
def without_threads_of_opencv() -> Iterator[None]:
    """OpenCV with one thread inside the block, in which copies are made: these would wait for ever for the threads that
    their original has."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


_make: Callable[[], Callable[[Any], Any]] | None = None
"""What makes that which this process, being a copy, does."""


def begin_as_copy(parent: int) -> None:
    """What a copy of a process does first: it ends with that one, leaves Ctrl-C to it, and computes on one thread.

    parent: number of the process that it is a copy of.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:  # it was gone before
        os._exit(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a whole group of processes: the first of them ends the others
    torch.set_num_threads(1)
    keep_freed_memory()


def _begin(make_work: Callable[[], Callable[[Any], Any]], parent: int) -> None:
    """In a copy, once."""
    global _make
    begin_as_copy(parent)
    _make = functools.cache(make_work)


def _run(item: Any) -> Any:
    assert _make is not None
    return _make()(item)
