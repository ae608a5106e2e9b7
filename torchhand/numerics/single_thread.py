"""Small tensors on one thread, whatever the process has chosen for the others.

torch and the MKL library in it divide their work among threads from a few hundred numbers on: sines and roots, every
product of matrices, every factorization, each function of a whole picture. One frame of a tracker is some two hundred
such operations of microseconds. Where the cores are free the second thread gains nothing; where they are not, each
operation waits until the operating system gives a core to its second thread.
"""

import contextlib
import ctypes
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import torch

_LIBRARIES = ("libtorch_cpu.so", "libtorch_cpu.dylib", "libiomp5md.dll")  # with OpenMP among what they load
_INHERITED = 0  # MKL's number for a thread that follows the process


@contextlib.contextmanager
def single_threaded() -> Iterator[None]:
    """torch computes with one thread inside the block, or the decorated function, in the calling thread alone.

    Both counts, of OpenMP and of MKL, belong to the calling thread: no other thread notices, also none that begins
    meanwhile, as after `torch.set_num_threads`. Without effect where the calling thread has one already, and where
    torch was built without OpenMP.
    """
    openmp = torch.get_num_threads()
    if openmp == 1:
        yield
        return
    set_openmp, set_mkl = _setters()
    set_openmp(1)
    mkl = set_mkl(1)
    try:
        yield
    finally:
        set_openmp(openmp)
        set_mkl(mkl)


@lru_cache(maxsize=1)
def _setters() -> tuple[Callable[[int], object], Callable[[int], int]]:
    """What sets the calling thread's number of OpenMP's threads, and of MKL's; the latter returns the one before."""
    folder = Path(torch.__file__).parent / "lib"
    path = next((folder / name for name in _LIBRARIES if (folder / name).is_file()), None)
    library = None if path is None else ctypes.CDLL(str(path))  # torch has loaded it: this is the same one
    return (
        getattr(library, "omp_set_num_threads", lambda count: None),
        getattr(library, "MKL_Set_Num_Threads_Local", lambda count: _INHERITED),
    )
