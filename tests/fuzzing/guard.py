"""What reading a damaged file may cost and touch."""

import contextlib
import os
import resource
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

MAX_SECONDS, MAX_BYTES = 10.0, 1 << 30
"""Seconds of computing, which a busy machine does not change, and memory that may be added."""
_PATIENCE_S = 120.0  # of waiting, for what hangs without computing
_HARD_BYTES = 3 << 30  # beyond which the system refuses memory
_CHANGES = ("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.truncate", "os.link", "os.symlink", "os.chmod")
_RUNS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "pickle.find_class")
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND

_allowed: Path | None = None
_seen: list[str] = []


class Overrun(BaseException):
    """A file took too long: no reader takes this for an error of the file."""


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if _allowed is None:
        return
    if event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
        mode, flags = arguments[1], arguments[2] or 0
        is_writing = any(letter in mode for letter in "wxa+") if isinstance(mode, str) else bool(flags & _WRITING)
        if is_writing:
            _judge(event, arguments[0])
    elif event in _CHANGES:
        for path in arguments[:2]:
            if isinstance(path, str | bytes | os.PathLike):
                _judge(event, path)
    elif event in _RUNS:
        _seen.append(f"{event} {arguments}")


def _judge(event: str, path: str | bytes | os.PathLike[str]) -> None:
    assert _allowed is not None
    place = os.path.abspath(os.fsdecode(path))
    if not place.startswith(str(_allowed)) and "__pycache__" not in place:
        _seen.append(f"{event} {place}")


sys.addaudithook(_watch)


@contextlib.contextmanager
def guarded(folder: Path) -> Iterator[None]:
    """Fail where the block computes for more than 10 s, hangs, takes more than 1 GB, runs programs, or touches files
    outside a folder."""
    global _allowed
    before, resident = _peak_bytes(), _resident_bytes()
    started = time.process_time()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    kinds = {signal.SIGPROF: (signal.ITIMER_PROF, MAX_SECONDS), signal.SIGALRM: (signal.ITIMER_REAL, _PATIENCE_S)}
    old = {number: signal.signal(number, _too_long) for number in kinds}
    _seen.clear()
    _allowed = folder.resolve()
    for timer, seconds in kinds.values():
        signal.setitimer(timer, seconds)
    resource.setrlimit(resource.RLIMIT_AS, (_virtual_bytes() + _HARD_BYTES, hard))
    try:
        yield
    finally:
        for number, (timer, _) in kinds.items():
            signal.setitimer(timer, 0)
            signal.signal(number, old[number])
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        _allowed = None
    peak = _peak_bytes()
    assert time.process_time() - started < MAX_SECONDS, "took too long inside a library"
    assert peak == before or peak - resident < MAX_BYTES, f"took {(peak - resident) >> 20} MiB"
    assert not _seen, f"touched {_seen}"


def _too_long(number: int, frame: FrameType | None) -> None:
    raise Overrun(f"took more than {MAX_SECONDS:g} s")


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def _virtual_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
