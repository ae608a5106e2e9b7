"""One thread for one block of one thread: nobody else's count changes."""

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

import pytest
import torch

from torchhand.numerics import single_thread
from torchhand.numerics.single_thread import single_threaded

OTHERS = 3


@pytest.fixture
def several() -> Iterator[None]:
    """The process computes with some threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(OTHERS)
    yield
    torch.set_num_threads(before)


def in_a_thread(call: Callable[[], int]) -> int:
    """The result of a call in a thread of its own."""
    found: list[int] = []
    thread = threading.Thread(target=lambda: found.append(call()))
    thread.start()
    thread.join()
    return found[0]


@pytest.mark.usefixtures("several")
def test_the_calling_thread_has_one_and_has_its_own_back_after_an_error() -> None:
    counts = []

    @single_threaded()
    def fail() -> None:
        with single_threaded():
            counts.append(torch.get_num_threads())
        counts.append(torch.get_num_threads())
        raise RuntimeError("within")

    with pytest.raises(RuntimeError, match="within"):
        fail()
    assert [*counts, torch.get_num_threads()] == [1, 1, OTHERS]


@pytest.mark.usefixtures("several")
def test_threads_that_begin_meanwhile_have_the_count_of_the_process() -> None:
    with single_threaded():
        assert in_a_thread(torch.get_num_threads) == OTHERS
    assert in_a_thread(torch.get_num_threads) == OTHERS


@pytest.mark.usefixtures("several")
def test_blocks_of_two_threads_that_overlap_leave_each_thread_its_own_count() -> None:
    """One leaves its block while the other, which began before, is still in its own."""
    has_begun, has_ended = threading.Event(), threading.Event()
    counts: dict[str, list[int]] = {"long": [], "short": []}

    @single_threaded()
    def long() -> None:
        has_begun.set()
        assert has_ended.wait(30)
        counts["long"].append(torch.get_num_threads())

    @single_threaded()
    def short() -> None:
        counts["short"].append(torch.get_num_threads())

    def work(name: str, call: Callable[[], None]) -> None:
        call()
        counts[name].append(torch.get_num_threads())

    thread = threading.Thread(target=work, args=("long", long))
    thread.start()
    assert has_begun.wait(30)
    work("short", short)
    has_ended.set()
    thread.join()
    assert counts == {"long": [1, OTHERS], "short": [1, OTHERS]}


@pytest.mark.usefixtures("several")
def test_nothing_is_set_in_a_thread_that_has_one() -> None:
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(single_thread, "_setters", lambda: pytest.fail("a count was set"))
        with single_threaded():
            assert torch.get_num_threads() == 1


@pytest.mark.usefixtures("several")
def test_a_decorated_function_has_one_thread_and_gives_its_result() -> None:
    assert single_threaded()(torch.get_num_threads)() == 1
    assert torch.get_num_threads() == OTHERS


_COUNTING = """
import os, torch
from torchhand.numerics import single_threaded

torch.set_num_threads(3)

def work():
    square = torch.rand(81, 81, dtype=torch.float64)
    definite = square @ square.mT + 81 * torch.eye(81)
    torch.linalg.solve_triangular(torch.linalg.cholesky(definite), square, upper=False)
    torch.rand(480, 640).sin().sum()

def threads():
    return len(os.listdir("/proc/self/task"))

before = threads()
with single_threaded():
    work()
print(threads() - before)
work()
print(threads() - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="threads are counted in /proc")
def test_no_thread_is_started_for_what_would_start_some() -> None:
    result = subprocess.run([sys.executable, "-c", _COUNTING], capture_output=True, text=True)
    assert result.stderr == ""
    inside, outside = map(int, result.stdout.split())
    assert inside == 0
    assert outside > 0  # or else the machine's torch spreads nothing, and the test says nothing
