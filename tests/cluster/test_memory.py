"""Freed memory stays with the process that asks for it, and comes to it without new pages."""

import os
import platform
import resource
import subprocess
import sys

import pytest

_WORK = """
import resource, sys, torch
from torchhand.cluster import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory()
for turn in range(20):
    if turn == 10:
        begun = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    held = [torch.ones(1 << 20) for _ in range(12)]  # of 4 MiB each
    del held
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - begun)
"""


def _page_faults(how: str) -> int:
    """Of a process in which the C library gives every large block back as soon as it is freed; by itself it does so
    where its heap happens to allow it."""
    env = os.environ | {"MALLOC_MMAP_THRESHOLD_": "131072"}
    done = subprocess.run([sys.executable, "-c", _WORK, how], capture_output=True, text=True, check=True, env=env)
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps memory in its own way")
def test_freed_memory_is_taken_again() -> None:
    """Of the pages of 10 times 12 tensors next to none come anew; without it they all do."""
    pages = 10 * 12 * (4 << 20) // resource.getpagesize()
    assert _page_faults("plain") > 0.5 * pages
    assert _page_faults("kept") < 0.05 * pages
