"""The videos of a folder, each tracked by itself: what is told of each, and many at once, here or on a cluster."""

import contextlib
import functools
import io
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torchhand.cluster import Cluster, Copies
from torchhand.errors import DiskError, InputError
from torchhand.files import Track
from torchhand.files.detections import KEYPOINTS_NAME
from torchhand.files.disk import expanded
from torchhand.files.pictures import pixel_limit
from torchhand.runs.progress import untold_progress
from torchhand.runs.request import Request
from torchhand.runs.tracking import summary_of, track_sequence
from torchhand.track import STILL_SEARCHED


@dataclass(frozen=True, kw_only=True)
class Video:
    """One of several inputs, and where its result goes."""

    name: str
    source: str | Path
    out_dir: Path
    keypoints: Path | None = None
    """Its own file of detected keypoints; that of the request, if any, where there is none."""

    def request_of(self, request: Request) -> Request:
        """What is asked for with this video."""
        return request if self.keypoints is None else replace(request, keypoints=(self.keypoints,))


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
    return workers.done(functools.partial(_worker, replace(request, workers=1), max_megapixels), videos)


def with_own_keypoints(videos: Sequence[Video], keypoints: Sequence[Path]) -> list[Video]:
    """The videos of a folder, each with the file of its name: NAME.npz, NAME.npy, NAME.json or a folder NAME of
    OpenPose's in the folder of keypoints, or the keypoints.npz of an older result NAME there.

    Raises InputError where a video has none, and where one file is given for several videos.
    """
    if not keypoints:
        return list(videos)
    folder = expanded(keypoints[0])
    found = [_keypoints_in(folder, video.name) for video in videos]
    if len(videos) == 1 and found == [None]:
        return list(videos)
    kinds = f"NAME.npz, NAME.npy, NAME.json, a folder NAME of OpenPose's, or NAME/{KEYPOINTS_NAME}"
    expected = f"{folder}: expected a folder with keypoints of each video ({kinds})"
    if folder.is_file():
        raise InputError(f"{expected}, got a file for {len(videos)} videos")
    missing = [video.name for video, own in zip(videos, found, strict=True) if own is None]
    if missing:
        raise InputError(f"{expected}, found none of {', '.join(missing[:3])}{' and others' * (len(missing) > 3)}")
    if any(own == expanded(video.out_dir) / KEYPOINTS_NAME for video, own in zip(videos, found, strict=True)):
        raise InputError(f"--keypoints: expected another folder than that of --out, got {folder}")
    return [replace(video, keypoints=own) for video, own in zip(videos, found, strict=True)]


def without_hand(track: Track, advice: str = "name its --posture, or give --start-points or --keypoints") -> str | None:
    """What to tell where no hand was found in any frame; advice: what may help."""
    if not len(track) or any(status in ("tracked", "recovered") for status in track.status):
        return None
    reason = _usual_reason(track)
    if reason == STILL_SEARCHED:
        return f"no hand was found: {reason}, which takes seconds"
    return f"no hand was found{f' ({reason})' if reason else ''}; {advice}"


def _usual_reason(track: Track) -> str:
    """Why most of the frames without a hand have none, those before the end of the first search aside; empty where none
    tells."""
    reasons = Counter(text for text in ([] if track.reason is None else track.reason.tolist()) if text)
    if len(reasons) > 1:
        reasons.pop(STILL_SEARCHED, None)
    return max(reasons, key=reasons.__getitem__, default="")


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
        line = without_hand(track)
        said += [] if line is None else [f"{video.name}: {line}"]
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


def _keypoints_in(folder: Path, name: str) -> Path | None:
    places = (folder / name / KEYPOINTS_NAME, *(folder / f"{name}{kind}" for kind in (".npz", ".npy", ".json", "")))
    return next((place for place in places if place.exists()), None)


def _continued(request: Request, video: Video) -> Request:
    """The request, to go on with what a lost worker has begun: a new folder was empty when the command began."""
    has_begun = not request.overwrite and video.out_dir.is_dir() and any(video.out_dir.iterdir())
    own = video.request_of(request)
    return replace(own, resume=True) if has_begun else own
