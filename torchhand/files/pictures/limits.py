"""How large a picture may be before it is not decoded at all."""

import contextlib
import math
from collections.abc import Iterator
from contextvars import ContextVar

from torchhand.errors import InputError

MAX_MEGAPIXELS = 64.0
"""Default: photographs of telephones have 12 to 50. Two hundred bytes may claim to be a picture of gigabytes."""
SMALLEST_SIDE = 8
"""Pixels along either side of the smallest picture that is read: less shows nothing."""
_limit = ContextVar("max_megapixels", default=MAX_MEGAPIXELS)


@contextlib.contextmanager
def pixel_limit(megapixels: float) -> Iterator[None]:
    """Pictures and videos of up to so many million pixels are read inside the block, by this thread or task.

    Raises InputError unless the limit is above 0 and finite.
    """
    if not 0 < megapixels < math.inf:
        raise InputError(f"--max-megapixels: expected a number above 0, got {megapixels:g}")
    token = _limit.set(megapixels)
    try:
        yield
    finally:
        _limit.reset(token)


def size_problem(width: int, height: int) -> str:
    """Why a picture of this size is not read; empty where it is."""
    if width < SMALLEST_SIDE or height < SMALLEST_SIDE:
        return f"expected a picture of {SMALLEST_SIDE}x{SMALLEST_SIDE} px or more, got {width}x{height}"
    most = _limit.get()
    if width * height <= most * 1e6:
        return ""
    return f"expected at most {most:g} megapixels, got {width}x{height} px (--max-megapixels)"


def largest_size() -> int:
    """Pixels of the largest picture that is read."""
    return max(1, int(min(_limit.get() * 1e6, 2**31 - 1)))
