"""What the measures of both trackers share: their speed from frame to frame, their memory over a long recording."""

import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any, TypeVar

import torch
from tqdm import tqdm

import torchhand
from torchhand.cli.benchmarks.figures import Figure
from torchhand.evaluate import PROC, time_interleaved, watch_memory
from torchhand.files import load_track
from torchhand.files.results import JSONL_NAME, unfinished_run

FRAMES_PER_SECOND = 30.0
MEMORY_SKIP = 100
"""Frames after which memory may not grow any more."""

Item = TypeVar("Item")


def speed_figure(
    name: str,
    run: Callable[[], Sequence[str]],
    repeats: int,
    *,
    must: float,
    aim: float,
    details: Mapping[str, Any],
) -> Figure:
    """Frames per second of a tracker. run: tracks all frames and returns their statuses."""
    statuses = run()
    [timing] = time_interleaved({"ours": run}, repeats, warm_up=0).values()
    per_frame = timing.median / len(statuses)
    tracked = statuses.count("tracked")
    return Figure(
        name=name,
        value=1e3 / per_frame,
        unit="frames/s",
        must=must,
        aim=aim,
        ours_ms=per_frame,
        repeats=repeats,
        note="" if tracked == len(statuses) else f"only {tracked} of {len(statuses)} frames were tracked",
        details={**details, "frames": len(statuses), "tracked": tracked}
        | {"ours_fastest_ms": timing.fastest / len(statuses)},
    )


def memory_figure(
    name: str, prepare: Callable[[Path], Sequence[str]], *, must: float, frames: int, size: tuple[int, int]
) -> Figure:
    """Resident memory of a tracking command over a long recording; nothing may grow with its length.

    prepare: writes the recording into a folder and returns the command with what it needs besides the common options.
    frames: that it tracks. size: of the pictures, px.
    """
    if not PROC.is_dir():
        note = f"resident memory is read from {PROC}, which this system does not have"
        return Figure(name=name, value=None, unit="MiB", must=must, repeats=0, note=note)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        call = [sys.executable, "-m", "torchhand.cli", *prepare(Path(folder)), "--out", str(out), "--no-overlay"]
        call += ["--threads", str(torch.get_num_threads())]
        with with_bar(None, frames, "tracking") as bar:
            used = watch_memory(
                call,
                partial(_lines_of, out),
                skip=MEMORY_SKIP,
                environment=own_environment(),
                progress=lambda done: bar.update(done - bar.n),
            )
        tracked = int((load_track(out).status == "tracked").sum())
    growth = "unknown" if used.growth is None else f"{used.growth:+.2f} MiB per 100 frames"
    return Figure(
        name=name,
        value=used.peak,
        unit="MiB",
        must=must,
        repeats=1,
        note=f"growth from frame {MEMORY_SKIP} on: {growth}",
        details={
            "growth_mib_per_100_frames": used.growth,
            "frames": used.frames,
            "tracked": tracked,
            "picture": list(size),
        },
    )


def there_and_back(items: Sequence[Item], frames: int, what: str) -> Iterable[Item]:
    """So many frames of a motion that goes forth and back again and again, with a progress bar."""
    return with_bar(islice(cycle((*items, *items[-2:0:-1])), frames), frames, what)


def with_bar(steps: Iterable[Any] | None, total: int, what: str) -> Any:
    return tqdm(steps, total=total, desc=what, unit="frame", leave=False, disable=not sys.stderr.isatty())


def own_environment() -> dict[str, str]:
    """Environment of a process that shall find this package, installed or not."""
    package = str(Path(torchhand.__file__).resolve().parents[1])
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))}


def _lines_of(out: Path) -> int:
    """Frames that a run has written down."""
    folder = unfinished_run(out)
    return 0 if folder is None else (folder / JSONL_NAME).read_bytes().count(b"\n")
