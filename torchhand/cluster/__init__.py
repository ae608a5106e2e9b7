"""Work over the processes of one machine or many, by Ray (extra `cluster`), and the memory of a process at work."""

from torchhand.cluster.memory import keep_freed_memory
from torchhand.cluster.spread import Cluster

__all__ = ["Cluster", "keep_freed_memory"]
