"""Independent pieces of work over the workers of a Ray cluster; what a lost worker had is done again by another."""

import contextlib
import functools
import importlib
import os
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import torch

from torchhand.cluster.memory import keep_freed_memory
from torchhand.errors import InputError

_AHEAD = 2
"""Pieces per processor that are handed out at a time, so that no worker waits for the next one."""
_STORE_BYTES = 1 << 28
"""Memory shared by the processes of a cluster that is started here; pieces and results are small."""

Item = TypeVar("Item")
Result = TypeVar("Result")


class Cluster:
    """A Ray cluster that is there, or one of this machine's processors for as long as the block lasts.

    Workers need the same torchhand and torch as this process; each computes with one thread, so that the results do not
    depend on where they were computed.
    """

    def __init__(self, address: str | None = None, *, processes: int | None = None) -> None:
        """address: as `ray.init` takes it (`auto`, `ray://HOST:10001`, `HOST:6379`); None starts a cluster here, of as
        many processes as given, or as there are processors.

        Raises InputError where Ray is not installed, or the cluster does not answer.
        """
        try:
            self._ray: Any = importlib.import_module("ray")
        except ImportError as error:
            raise InputError("--ray needs Ray: pip install 'torchhand[cluster]'") from error
        quiet = {"log_to_driver": False, "configure_logging": True, "logging_level": "error"}
        own = {
            "num_cpus": processes,
            "include_dashboard": False,
            "object_store_memory": _STORE_BYTES,
            "_system_config": {"worker_niceness": 0},  # Ray's own is 15, for clusters that others share
        }
        try:
            self._ray.init(**quiet, **({"address": "local", **own} if address is None else {"address": address}))
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            reason = " ".join(str(error).split()).split(". ")[0]
            raise InputError(f"--ray {address or ''}: no Ray cluster answers ({reason})") from error

    @property
    def processors(self) -> int:
        """Of all machines, as they are now."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def done(
        self, make_work: Callable[[], Callable[[Item], Result]], items: Sequence[Item]
    ) -> Iterator[tuple[Item, Result]]:
        """Items with their results as they are done, in no order.

        make_work: makes, once in each worker, the function that is called with its items. What that raises is raised
        here; a worker that is lost is replaced, and its items are done again.
        """
        run = self._ray.remote(num_cpus=1, max_retries=-1)(_run)
        shared, token = self._ray.put((make_work, Path.cwd())), uuid.uuid4().hex
        waiting, running = iter(items), dict[Any, Item]()
        while True:
            for item in waiting:
                running[run.remote(token, [shared], item)] = item
                if len(running) >= _AHEAD * self.processors:
                    break
            if not running:
                return
            for finished in self._ray.wait(list(running), num_returns=1)[0]:
                yield running.pop(finished), self._ray.get(finished)

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(Exception):
            self._ray.shutdown()


def _run(token: str, shared: Sequence[Any], item: Any) -> Any:
    """In a worker. `shared` is a list, so that Ray hands over the reference, not a copy for every item."""
    return _work(token, shared[0])(item)


@functools.lru_cache(maxsize=1)
def _work(token: str, shared: Any) -> Callable[[Any], Any]:
    """What the worker makes once: for the token, since references to one object may differ."""
    torch.set_num_threads(1)
    keep_freed_memory()
    make, folder = importlib.import_module("ray").get(shared)
    with contextlib.suppress(OSError):
        os.chdir(folder)  # relative paths lead where they lead for who asks
    return make()
