"""Endurance in `torchhand benchmark`: filters on hostile input, and the memory of a tracker that does not stop."""

import os
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import torch

from torchhand.cli.benchmarks.figures import Figure
from torchhand.cli.benchmarks.runs import FRAMES_PER_SECOND, there_and_back, with_bar
from torchhand.cli.benchmarks.tracking import simulated_views
from torchhand.evaluate import PROC, resident_memory
from torchhand.files import load_hand_model, save_cameras, write_video
from torchhand.runs import settings_of
from torchhand.runs.recordings import OneCameraRecording
from torchhand.simulate import SceneSettings
from torchhand.study.soak import SoakSettings, soak_filters
from torchhand.track import Tracker

GROWTH_MUST_MIB = 5.0
_CONFIG, _SIZE_PX, _RENDERED = "contour_full", (640, 480), 30
_SETTLED_S = 60.0
"""Seconds after which memory may not grow any more; a quarter of a run that is shorter than four minutes."""
_SAMPLES_S = 1.0


def soak_of_filters(name: str, repeats: int | None, *, steps: int = 1_000_000) -> Figure:
    """Every kind of filter in float32 and float64 on outliers, gaps, infinities, NaN and covariances without rank."""
    with with_bar(None, steps, "filter steps") as bar:
        found = soak_filters(SoakSettings(steps=steps), bar.update)
    done = sum(found.steps.values())
    faults = sum(found.faults.values())
    note = "; ".join(f"{fault} ({count} times)" for fault, count in found.faults.items())
    return Figure(
        name=name,
        value=float(faults),
        unit="faults",
        must=1.0,
        ours_ms=1e3 * found.seconds / done,
        repeats=1,
        note=note or f"{done} steps of {len(found.steps)} kinds: all beliefs finite, symmetric, semi-definite",
        details={
            "steps": dict(found.steps),
            "faults": dict(found.faults),
            "lowest_eigenvalue_roundings": dict(found.lowest),
            "seconds": found.seconds,
        },
    )


@dataclass(frozen=True, kw_only=True)
class _Endurance:
    """What a tracker's process needed while it ran."""

    samples: list[tuple[float, float]]
    """Seconds since the start, resident memory in MiB."""
    statuses: Counter[str]


def soak_of_tracking(name: str, repeats: int | None, *, minutes: float = 60.0) -> Figure:
    """Growth of the resident memory of a tracker that follows a looped video, after its first minute."""
    if not PROC.is_dir():
        note = f"resident memory is read from {PROC}, which this system does not have"
        return Figure(name=name, value=None, unit="MiB", must=GROWTH_MUST_MIB, repeats=0, note=note)
    with tempfile.TemporaryDirectory() as folder:
        found = _track_looped(_looping_video(Path(folder)), 60.0 * minutes)
    frames, spent_s = found.statuses.total(), found.samples[-1][0]
    settled_s = min(_SETTLED_S, 0.25 * spent_s)
    settled = [memory for seconds, memory in found.samples if seconds >= settled_s]
    return Figure(
        name=name,
        value=max(settled) - settled[0],
        unit="MiB",
        must=GROWTH_MUST_MIB,
        ours_ms=1e3 * spent_s / frames,
        repeats=1,
        note=f"{frames} frames in {spent_s / 60:.1f} min; {settled[0]:.0f} MiB after {settled_s:.0f} s,"
        f" {settled[-1]:.0f} MiB at the end",
        details={
            "frames": frames,
            "statuses": dict(found.statuses),
            "settled_s": settled_s,
            "first_mib": settled[0],
            "highest_mib": max(settled),
            "last_mib": settled[-1],
        },
    )


def _looping_video(folder: Path) -> OneCameraRecording:
    """A hand that moves forth and back, as a video in the folder with its camera."""
    camera, views = simulated_views("free", _SIZE_PX, _RENDERED, SceneSettings())
    pictures = [view.image for view in views if view.image is not None]
    save_cameras([camera], folder / "cameras.json")
    width, height = _SIZE_PX
    with write_video(folder / "hand.mp4", width=width, height=height, fps=FRAMES_PER_SECOND) as writer:
        for picture in there_and_back(pictures, 2 * len(pictures) - 2, "writing"):
            writer.write(picture)
    return OneCameraRecording(folder / "hand.mp4", folder / "cameras.json")


def _track_looped(recording: OneCameraRecording, seconds: float) -> _Endurance:
    """Follow the hand through the recording, again and again, for so many seconds."""
    hand = load_hand_model().hand(dtype=torch.float64)
    tracker, state = Tracker(hand, recording.cameras, settings_of(_CONFIG)), None
    found, began = _Endurance(samples=[], statuses=Counter()), time.monotonic()
    with with_bar(None, round(seconds), "seconds of tracking") as bar:
        while True:
            with recording.opened(0) as frames:
                for frame in frames:
                    time_s = found.statuses.total() / FRAMES_PER_SECOND
                    state, estimate = tracker.step(state, frame.views, time_s)
                    found.statuses[estimate.status] += 1
                    spent_s = time.monotonic() - began
                    if spent_s >= _SAMPLES_S * len(found.samples):
                        found.samples.append((spent_s, resident_memory(os.getpid())[0]))
                        bar.update(round(spent_s) - bar.n)
                    if spent_s >= seconds:
                        recording.close()
                        return found
