"""Work over the processes of one machine or many, by Ray (extra `cluster`)."""

from torchhand.cluster.spread import Cluster

__all__ = ["Cluster"]
