"""Batches of a study worked on side by side, each kept as soon as it is done."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import torch
from tqdm import tqdm

from torchhand.cluster import Cluster, Copies, can_copy_process, done_by, keep_freed_memory
from torchhand.study.hypotheses.case_study import StudyBatch
from torchhand.study.hypotheses.folder import StudyFolder
from torchhand.study.hypotheses.record import Hypotheses

Worker = Callable[[StudyBatch], Hypotheses]


def run_batches(
    plan: Sequence[StudyBatch],
    make_worker: Callable[..., Worker],
    folder: StudyFolder,
    workers: int | Cluster,
    device: str,
) -> tuple[Hypotheses, float]:
    """All hypotheses in the plan's order, also those that the folder has; and seconds per start, 0 if none was left.

    make_worker: makes what registers batches; it is given the number of threads that share it. workers: how many work
    side by side on this machine, or a cluster. Copies of this process where it can be copied, as well as a cluster's,
    make one each; else threads share one. device: that batches are registered on.
    """
    left = [batch for batch in plan if batch.index not in folder.batches]
    starts = sum(batch.count for batch in plan)
    before = starts - sum(batch.count for batch in left)
    begun = time.perf_counter()
    is_hidden = not sys.stderr.isatty()
    with tqdm(total=starts, initial=before, desc="study", unit="start", disable=is_hidden, leave=False) as bar:
        for batch, found in _worked(left, make_worker, workers, torch.device(device)):
            folder.batches.save(batch.index, found)
            bar.update(len(found))
    seconds = (time.perf_counter() - begun) / (starts - before) if left else 0.0
    return Hypotheses.joined((folder.batches.load(batch.index) for batch in plan), starts), seconds


def _worked(
    plan: Sequence[StudyBatch], make_worker: Callable[..., Worker], workers: int | Cluster, device: torch.device
) -> Iterator[tuple[StudyBatch, Hypotheses]]:
    """Batches as they are done. torch computes each with one thread, so that its company changes no number."""
    if isinstance(workers, Cluster):
        yield from workers.done(make_worker, plan)
        return
    if workers > 1 and can_copy_process(device):
        yield from Copies(workers).done(make_worker, plan)
        return
    keep_freed_memory()
    side_by_side, work = workers, make_worker(workers)
    if side_by_side == 1:
        yield from ((batch, work(batch)) for batch in plan)
        return
    with ThreadPoolExecutor(side_by_side, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        yield from done_by(pool, work, plan, at_once=side_by_side)
