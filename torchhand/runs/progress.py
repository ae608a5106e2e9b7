"""How far a run is: a bar on a terminal, elsewhere a line now and then."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from typing import Any

from tqdm import tqdm

_EVERY_S = 10.0  # from line to line
_is_told: ContextVar[bool] = ContextVar("is_told", default=True)


class Progress:
    """Counts frames, and tells of them."""

    def __init__(self, bar: tqdm | None, what: str, total: int | None, say: Callable[[str], None]) -> None:
        self._bar, self._what, self._total, self._say = bar, what, total, say
        self._count, self._started_s = 0, time.monotonic()
        self._said_s = self._started_s

    def update(self, counts: Mapping[Any, int] | None = None, *, frames: int = 1) -> None:
        """So many more are done. counts: what there was, by name."""
        self._count += frames
        told = {name: count for name, count in (counts or {}).items() if count}
        if self._bar is not None:
            self._bar.set_postfix(told, refresh=False)
            self._bar.update(frames)
            return
        now_s = time.monotonic()
        if _is_told.get() and now_s - self._said_s >= _EVERY_S:
            self._said_s = now_s
            self._say(self._line(told, now_s - self._started_s))

    def _line(self, told: Mapping[str, int], spent_s: float) -> str:
        rate = self._count / spent_s
        done = f"{self._count}" if self._total is None else f"{self._count} of {self._total}"
        left = "" if self._total is None else f", {max(0, self._total - self._count) / rate:.0f} s left"
        kinds = "".join(f", {count} {name}" for name, count in told.items())
        return f"{self._what}: {done} frames, {rate:.1f} per second{left}{kinds}"


@contextlib.contextmanager
def untold_progress() -> Iterator[None]:
    """No lines within the block: nobody reads them before all is done."""
    before = _is_told.set(False)
    try:
        yield
    finally:
        _is_told.reset(before)


@contextlib.contextmanager
def progress(what: str, total: int | None, say: Callable[[str], None]) -> Iterator[Progress]:
    """A bar where standard error is a terminal; else a line every ten seconds, by `say`."""
    if not sys.stderr.isatty():
        yield Progress(None, what, total, say)
        return
    with tqdm(total=total, desc=what, unit="frame", dynamic_ncols=True) as bar:
        yield Progress(bar, what, total, say)
