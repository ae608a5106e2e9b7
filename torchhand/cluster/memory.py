"""Memory of a process that computes with many tensors of a few megabytes, one after the other."""

import contextlib
import ctypes

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
"""Numbers of mallopt(3), as malloc.h of glibc has them."""
_LARGEST = 1 << 25
"""Bytes above which memory is asked of the system one by one: the most that glibc takes."""
_KEPT = 1 << 27
"""Free bytes at the end of the heap, from which on they are given back."""
_AHEAD = 1 << 24
"""Bytes asked for at a time."""


def keep_freed_memory() -> None:
    """What is freed stays with this process for what comes next, until it ends.

    Else glibc gives every tensor above 128 KiB back at once, and the system clears its pages anew for the next one: a
    tenth of the time of a study. Does nothing where the C library is another.
    """
    with contextlib.suppress(OSError, AttributeError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        for parameter, value in ((_MMAP_THRESHOLD, _LARGEST), (_TRIM_THRESHOLD, _KEPT), (_TOP_PAD, _AHEAD)):
            mallopt(parameter, value)
