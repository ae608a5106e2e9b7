"""Work over copies of this process: all of it is done, what is raised there is raised here, and none outlives it."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.cluster import Copies, can_copy_process, side_by_side
from torchhand.devices import HOST
from torchhand.errors import InputError
from torchhand.numerics import single_threaded

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems do not copy processes")


def test_items_come_with_their_results_from_other_processes() -> None:
    """Pictures, worked on by OpenCV in many threads here and in one there, and by torch with one."""
    picture = np.arange(480 * 640, dtype=np.uint8).reshape(480, 640)
    expected, threads_of_opencv = cv2.GaussianBlur(picture, (31, 31), 5), cv2.getNumThreads()

    def make() -> Callable[[int], tuple[int, int, np.ndarray]]:
        return lambda item: (os.getpid(), torch.get_num_threads(), cv2.GaussianBlur(picture, (31, 31), 5) + item)

    done = dict(Copies(2).done(make, range(12)))
    assert sorted(done) == list(range(12))
    assert os.getpid() not in {process for process, _, _ in done.values()}
    assert {threads for _, threads, _ in done.values()} == {1}
    for item, (_, _, blurred) in done.items():
        np.testing.assert_array_equal(blurred, expected + item)
    assert cv2.getNumThreads() == threads_of_opencv


def test_nothing_to_do_needs_no_process() -> None:
    assert not list(Copies(2).done(lambda: pytest.fail, []))


def test_what_work_raises_is_raised_here() -> None:
    def work(item: int) -> int:
        if item == 3:
            raise InputError("three is not allowed")
        return item

    with pytest.raises(InputError, match=r"^three is not allowed$"):
        list(Copies(2).done(lambda: work, range(5)))


def test_what_making_the_work_raises_is_raised_here() -> None:
    def make() -> Callable[[int], int]:
        raise InputError("nothing to work with")

    with pytest.raises(InputError, match=r"^nothing to work with$"):
        list(Copies(2).done(make, range(5)))


def test_work_is_made_once_in_each_process() -> None:
    made: list[int] = []

    def make() -> Callable[[int], int]:
        made.append(1)
        return lambda _: len(made)

    assert {count for _, count in Copies(2).done(make, range(10))} == {1}


def test_a_lost_process_is_told_in_one_line() -> None:
    def work(item: int) -> int:
        if item == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return item

    with pytest.raises(InputError, match=r"^a process at work was ended from outside"):
        list(Copies(2).done(lambda: work, range(5)))


def test_who_goes_on_no_further_does_not_wait_for_what_is_at_work() -> None:
    """As after Ctrl-C, which copies leave to their original."""

    def work(item: int) -> int:
        time.sleep(600 * item)
        return os.getpid()

    def interrupted() -> None:
        for _ in Copies(2).done(lambda: work, range(2)):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not active_children()


def test_what_the_caller_begins_meanwhile_is_not_ended() -> None:
    other = get_context("fork").Process(target=time.sleep, args=(600,), daemon=True)
    results = Copies(2).done(lambda: abs, [1, 2])
    next(results)
    other.start()
    results.close()  # pyright: ignore[reportAttributeAccessIssue]
    try:
        assert active_children() == [other]
    finally:
        other.kill()
        other.join()


def test_jobs_side_by_side_give_what_they_give_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(3, 200, 200, dtype=torch.float64, generator=generator)

    def job(place: int) -> tuple[int, torch.Tensor]:
        with torch.inference_mode():
            return os.getpid(), values[place] @ values[place]

    jobs = [partial(job, place) for place in range(3)]
    found = {}
    for cores in (1, 2):
        monkeypatch.setattr("torchhand.cluster.processes.usable_cores", lambda cores=cores: cores)
        with single_threaded():
            found[cores] = side_by_side(jobs, HOST)
    assert {process for process, _ in found[1]} == {os.getpid()}
    assert os.getpid() not in {process for process, _ in found[2]}
    for (_, here), (_, there) in zip(found[1], found[2], strict=True):
        assert torch.equal(here, there)


_ORPHANS = """
import os, sys, time
from pathlib import Path
from torchhand.cluster import Copies
def work(item):
    (Path(sys.argv[1]) / str(os.getpid())).touch()
    time.sleep(600)
list(Copies(2).done(lambda: work, range(2)))
"""


def test_copies_end_with_the_process_that_made_them(tmp_path: Path) -> None:
    """Killed, it can tell them nothing."""
    process = subprocess.Popen([sys.executable, "-c", _ORPHANS, str(tmp_path)])
    try:
        copies = _waited_for(lambda: [int(file.name) for file in tmp_path.iterdir()], 2)
    finally:
        process.kill()
    process.wait()
    _waited_for(lambda: [copy for copy in copies if not _is_alive(copy)], 2)


def _waited_for(found: Callable[[], list[int]], count: int, most_s: float = 60.0) -> list[int]:
    end = time.monotonic() + most_s
    while len(here := found()) < count:
        assert time.monotonic() < end
        time.sleep(0.05)
    return here


def _is_alive(process: int) -> bool:
    """Not gone, and not a dead one that nobody has asked about yet."""
    try:
        status = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return status != "Z"


def test_accelerators_work_in_this_process() -> None:
    assert can_copy_process(torch.device("cpu"))
    assert not can_copy_process(torch.device("meta"))
    assert not can_copy_process(torch.device("cuda"))
