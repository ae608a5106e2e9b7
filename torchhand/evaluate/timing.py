"""Speed and memory, measured side by side: repeats of all candidates interleaved, medians, ratios within a repeat."""

import gc
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Threads of numpy's and torch's libraries, which read them once, when they are loaded."""

PROC = Path("/proc/self")
"""Where Linux tells a process's memory."""

_MIB = 1 / 1024  # of a KiB, which the kernel counts in
_GROWTH_UNIT = 100  # frames
_MIN_SAMPLES = 10


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Milliseconds of one candidate in every repeat."""

    milliseconds: tuple[float, ...]

    @property
    def median(self) -> float:
        return statistics.median(self.milliseconds)

    @property
    def fastest(self) -> float:
        return min(self.milliseconds)

    def faster_than(self, other: "Timing") -> float:
        """How many times faster than the other: the median over repeats of the ratio within a repeat.

        What slows the machine down for a while slows both, and drops out.
        """
        pairs = zip(self.milliseconds, other.milliseconds, strict=True)
        return statistics.median(theirs / own for own, theirs in pairs)


def time_interleaved(
    candidates: Mapping[str, Callable[[], object]], repeats: int, *, warm_up: int = 1
) -> dict[str, Timing]:
    """Time every candidate once per repeat, in turn, after `warm_up` calls.

    Garbage is collected between repeats only.
    """
    for _ in range(warm_up):
        for call in candidates.values():
            call()
    spent: dict[str, list[float]] = {name: [] for name in candidates}
    was_collecting = gc.isenabled()
    gc.disable()
    try:
        for _ in range(repeats):
            gc.collect()
            for name, call in candidates.items():
                started = time.perf_counter()
                call()
                spent[name].append(1e3 * (time.perf_counter() - started))
    finally:
        if was_collecting:
            gc.enable()
    return {name: Timing(milliseconds=tuple(values)) for name, values in spent.items()}


def machine_facts() -> dict[str, Any]:
    """What a figure depends on: the machine, the versions, the threads, and how busy it was."""
    return {
        "cpu_count": os.cpu_count(),
        "processor": _processor(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "torch_threads": torch.get_num_threads(),
        "thread_variables": {name: os.environ[name] for name in THREAD_VARIABLES if name in os.environ},
        "load_average": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


@dataclass(frozen=True, kw_only=True)
class MemoryUse:
    """Resident memory of a process, MiB."""

    peak: float
    frames: int
    """Frames that it had done when it was last looked at."""
    growth: float | None
    """Slope per 100 frames after the first `skip`; None where too little was seen of them."""


def watch_memory(
    command: Sequence[str],
    frames_done: Callable[[], int],
    *,
    skip: int,
    environment: Mapping[str, str],
    every_s: float = 0.05,
    progress: Callable[[int], None] = lambda frames: None,
) -> MemoryUse:
    """Run a command and read its resident memory from PROC until it ends.

    Raises:
        RuntimeError: the command failed; its last words follow.
    """
    peak, samples = 0.0, []
    process = subprocess.Popen(
        command, env=dict(environment), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        while process.poll() is None:
            now, highest = resident_memory(process.pid)
            peak = max(peak, highest)
            if now > 0:
                samples.append((frames_done(), now))
                progress(samples[-1][0])
            time.sleep(every_s)
        words, _ = process.communicate()
    finally:
        process.kill()
        process.wait()
    if process.returncode != 0:
        raise RuntimeError(f"exit code {process.returncode} from {' '.join(command)}: {words.strip()[-500:]}")
    frames = max((done for done, _ in samples), default=0)
    return MemoryUse(peak=peak, frames=frames, growth=memory_growth(samples, skip=skip))


def memory_growth(samples: Sequence[tuple[int, float]], *, skip: int) -> float | None:
    """Slope of memory over frames, per 100 frames, by least squares; of frames `skip` to the last but one seen.

    When the last frame is done the process goes on to other work, whose memory says nothing about the frames.
    """
    last = max((frames for frames, _ in samples), default=0)
    kept = np.array([sample for sample in samples if skip <= sample[0] < last])
    if len(kept) < _MIN_SAMPLES or np.ptp(kept[:, 0]) == 0:
        return None
    return float(np.polyfit(kept[:, 0], kept[:, 1], 1)[0]) * _GROWTH_UNIT


def resident_memory(pid: int) -> tuple[float, float]:
    """Resident memory of a process now and at its highest so far, MiB; zeros when it has just ended."""
    try:
        lines = (PROC.parent / str(pid) / "status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0.0, 0.0
    fields = dict(line.split(":", 1) for line in lines if ":" in line)
    now, highest = (float(fields.get(name, "0 kB").split()[0]) * _MIB for name in ("VmRSS", "VmHWM"))
    return now, highest
