"""The videos of a folder, each tracked by itself: what is told of each, and many at once, here or on a cluster."""

import contextlib
import functools
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torchhand.cluster import Cluster, Copies
from torchhand.errors import DiskError, InputError
from torchhand.files import Track
from torchhand.files.pictures import pixel_limit
from torchhand.runs.progress import untold_progress
from torchhand.runs.request import Request
from torchhand.runs.tracking import summary_of, track_sequence


@dataclass(frozen=True, kw_only=True)
class Video:
    """One of several inputs, and where its result goes."""

    name: str
    source: str | Path
    out_dir: Path


@dataclass(frozen=True, kw_only=True)
class VideoReport:
    """What the user is told of one video."""

    said: tuple[str, ...]
    """Lines that came up while it was tracked."""
    summary: str = ""
    error: str = ""
    """Why it could not be tracked; empty where it was."""


def track_videos(
    workers: Cluster | Copies, request: Request, videos: Sequence[Video], max_megapixels: float
) -> Iterator[tuple[Video, VideoReport]]:
    """Each video by one worker of a cluster or one copy of this process, as they are done; what a lost worker of a
    cluster had is gone on with by another.

    A video that is wrong is told of in its report. Raises DiskError where the disk is full, and InputError where a copy
    is lost.
    """
    return workers.done(functools.partial(_worker, request, max_megapixels), videos)


def without_hand(name: str, track: Track) -> str | None:
    """What to tell where no hand was found in any frame."""
    if not len(track) or any(status in ("tracked", "recovered") for status in track.status):
        return None
    reason = "" if track.reason is None else next((f" ({text})" for text in track.reason if text), "")
    return f"{name}: no hand was found{reason}; name its --posture, or give --start-points"


def _worker(request: Request, max_megapixels: float) -> Callable[[Video], VideoReport]:
    def work(video: Video) -> VideoReport:
        said: list[str] = []
        try:
            with pixel_limit(max_megapixels), untold_progress(), _kept_from_terminal(said):
                track, _ = track_sequence(video.source, video.out_dir, _continued(request, video), said.append)
        except DiskError:
            raise
        except (InputError, OSError) as error:
            return VideoReport(said=tuple(said), error=str(error))
        line = without_hand(video.name, track)
        said += [] if line is None else [line]
        return VideoReport(said=tuple(said), summary=summary_of(video.name, track, video.out_dir))

    return work


@contextlib.contextmanager
def _kept_from_terminal(said: list[str]) -> Iterator[None]:
    """No progress bars within the block, which several videos would write over each other: they are drawn on terminals
    alone. Warnings become lines of what is said."""
    written = io.StringIO()
    try:
        with contextlib.redirect_stderr(written):
            yield
    finally:
        said += [line for line in written.getvalue().splitlines() if line.strip()]


def _continued(request: Request, video: Video) -> Request:
    """The request, to go on with what a lost worker has begun: a new folder was empty when the command began."""
    has_begun = not request.overwrite and video.out_dir.is_dir() and any(video.out_dir.iterdir())
    return replace(request, resume=True) if has_begun else request
