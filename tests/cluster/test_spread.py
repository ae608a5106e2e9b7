"""Work over Ray's workers: all of it is done, also where a worker is killed; without Ray one line."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from torchhand.cluster import Cluster
from torchhand.errors import InputError


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"^--ray needs Ray: pip install 'torchhand\[cluster\]'$"):
        Cluster()


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    pytest.importorskip("ray", reason="needs Ray: pip install 'torchhand[cluster]'")
    with Cluster(processes=2) as here:
        yield here


@pytest.mark.filterwarnings("ignore")
def test_what_a_killed_worker_had_is_done_again(cluster: Cluster, tmp_path: Path) -> None:
    def make() -> Callable[[int], int]:
        made = os.getpid()

        def work(item: int) -> int:
            assert os.getpid() == made
            was_killed = tmp_path / "killed"
            if item == 3 and not was_killed.exists():
                was_killed.touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return item**2

        return work

    assert dict(cluster.done(make, range(8))) == {item: item**2 for item in range(8)}
    assert (tmp_path / "killed").exists()


@pytest.mark.filterwarnings("ignore")
def test_what_the_work_raises_is_raised(cluster: Cluster) -> None:
    def make() -> Callable[[int], int]:
        def work(item: int) -> int:
            raise InputError(f"item {item}: is wrong")

        return work

    with pytest.raises(InputError, match="item 0: is wrong"):
        list(cluster.done(make, [0]))
