"""Work over the processes of this machine, or of many by Ray (extra `cluster`), and the memory of a process at work."""

from torchhand.cluster.memory import keep_freed_memory
from torchhand.cluster.processes import (
    Copies,
    begin_as_copy,
    can_copy_process,
    copies_for,
    done_by,
    side_by_side,
    usable_cores,
    without_threads_of_opencv,
)
from torchhand.cluster.spread import Cluster

__all__ = [
    "Cluster",
    "Copies",
    "begin_as_copy",
    "can_copy_process",
    "copies_for",
    "done_by",
    "keep_freed_memory",
    "side_by_side",
    "usable_cores",
    "without_threads_of_opencv",
]
