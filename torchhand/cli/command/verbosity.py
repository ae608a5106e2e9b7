"""How much a command tells on stderr, from its --quiet or --verbose until it ends."""

import contextlib
import io
import logging
import sys
import time
from collections.abc import Iterator
from contextvars import ContextVar
from typing import Any

LIBRARY = __name__.partition(".")[0]
ERROR = ": error: "
"""In every line that tells of an error."""

_log = logging.getLogger(__name__)
_until_the_end: ContextVar[contextlib.ExitStack] = ContextVar("until_the_end")


@contextlib.contextmanager
def telling() -> Iterator[None]:
    """Inside the block, a command may ask for more or less; afterwards everything is as before."""
    with contextlib.ExitStack() as stack:
        token = _until_the_end.set(stack)
        stack.callback(_until_the_end.reset, token)
        yield


def tell(name: str, *, is_quiet: bool, is_verbose: bool) -> None:
    """Tell nothing but errors, or what the library logs and the traceback of an error, until the command ends."""
    stack = _until_the_end.get(None)
    if stack is None:  # arguments are read by themselves
        return
    if is_quiet:
        stack.enter_context(contextlib.redirect_stderr(_ErrorsAlone(sys.stderr)))
    if is_verbose:
        stack.enter_context(_logged(name))


def is_verbose() -> bool:
    """Whether the library's log is shown."""
    return logging.getLogger(LIBRARY).isEnabledFor(logging.DEBUG)


@contextlib.contextmanager
def _logged(name: str) -> Iterator[None]:
    """The library's log on stderr, beside a progress bar that may run; at the end duration and memory."""
    logger, handler = logging.getLogger(LIBRARY), _BesideBars()
    handler.setFormatter(_SinceStart(name))
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        with contextlib.suppress(ImportError):  # no such module on Windows
            import resource

            _log.debug("done; memory at most %.0f MiB", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        logger.setLevel(level)
        logger.removeHandler(handler)


class _SinceStart(logging.Formatter):
    def __init__(self, name: str) -> None:
        super().__init__()
        self._name, self._began = name, time.time()

    def format(self, record: logging.LogRecord) -> str:
        return f"torchhand {self._name}: {record.created - self._began:7.2f} s  {record.getMessage()}"


class _BesideBars(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        from tqdm import tqdm

        tqdm.write(self.format(record), file=sys.stderr)


class _ErrorsAlone(io.TextIOBase):
    """Passes lines that tell of errors, and no others. No terminal, so that no progress bar is drawn on it."""

    def __init__(self, behind: Any) -> None:
        super().__init__()
        self._behind, self._line = behind, ""

    def write(self, text: str) -> int:
        *lines, self._line = (self._line + text).split("\n")
        for line in lines:
            if ERROR in line:
                self._behind.write(f"{line}\n")
        return len(text)
