"""The result folder of one sequence: written frame by frame, resumable, never worse than what was there before."""

import contextlib
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from torchhand.errors import InputError
from torchhand.files.disk import LineFile, explained_errors, read_lines, replacing, short
from torchhand.files.results.checkpoint import ResumePoint, State, load_checkpoint, save_checkpoint
from torchhand.files.results.replacement import finish_replacement, remove_entry, replace_result
from torchhand.files.results.track_file import (
    HEADER_NAME,
    JSONL_NAME,
    NPZ_NAME,
    UNFINISHED_NAME,
    keep_last_lines,
    load_track,
    read_header,
    wanted_end_of,
    write_header,
    write_npz,
)
from torchhand.files.results.track_record import FrameRecord, TrackHeader

HAND_NAME = "hand.json"
CONFIG_NAME = "config.yaml"
OVERLAY_NAME = "overlay.mp4"
REPORT_NAME = "report.html"
COMPARISON_NAME = "comparison.html"
CHECKPOINT_NAME = "checkpoint.pt"
DETECTIONS_NAME = "keypoints.jsonl"
"""What a detector that ran along has found."""

FORWARD_NAME = "forward.jsonl"
"""The lines of a forward pass that was corrected backwards: from these a run that is resumed goes on."""
BACKWARD_NAME = "backward.jsonl"
"""The lines of a backward pass that is under way."""

EVALUATION_NAME, STABILITY_NAME, RANGE_NAME = "evaluation.json", "stability.json", "range_of_motion.json"

# In the order in which they are moved into place: the result itself last.
TRACK_NAMES = (
    *(EVALUATION_NAME, STABILITY_NAME, RANGE_NAME),
    *(HAND_NAME, CONFIG_NAME, OVERLAY_NAME, REPORT_NAME, COMPARISON_NAME),
    *(CHECKPOINT_NAME, DETECTIONS_NAME, FORWARD_NAME, BACKWARD_NAME),
    *(HEADER_NAME, JSONL_NAME, NPZ_NAME),
)
_ASIDE_NAME = ".earlier"
"""Folder in that of a run for the files of an earlier one that never ended."""
_DETECTED_ARRAYS = re.compile(r"keypoints(_\d+)?\.npz")  # one per view


def check_output_folder(out_dir: str | Path, *, resume: bool = False, overwrite: bool = False) -> None:
    """Raise InputError where a run may not write into this folder; touches nothing, but for a replacement that a killed
    program had begun, which is finished."""
    path = Path(out_dir)
    finish_replacement(path, path / UNFINISHED_NAME)
    if resume and overwrite:
        raise InputError("expected at most one of --resume and --overwrite, got both")
    with explained_errors(path):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: expected a folder for the results, got a file")
        content = sorted(entry.name for entry in path.iterdir()) if path.is_dir() else []
    if content and not resume and not overwrite:
        names = ", ".join(content[:3]) + (", ..." if content[3:] else "")
        raise InputError(
            f"{path}: the output folder exists and is not empty ({names});"
            " give another, or --resume to go on, or --overwrite to replace its results"
        )


def unfinished_run(out_dir: Path) -> Path | None:
    """Where the lines of a run that `TrackWriter` goes on from stand: in the sub-folder of one that was to replace an
    older result, else in the folder itself; None where there are none."""
    return next((place for place in (out_dir / UNFINISHED_NAME, out_dir) if (place / JSONL_NAME).exists()), None)


class TrackWriter:
    """Writes the result folder of one sequence; use it as a context manager around the whole run.

    header.json is written once; track.jsonl grows by a line per frame, and by one for each that is corrected: a frame's
    last line counts. What a backward pass corrects is kept as it was in forward.jsonl. Leaving the block well leaves
    one line per frame and writes track.npz from them. Leaving it by an exception (Ctrl-C, a full disk) keeps the lines,
    and writes track.npz from them where the disk allows; an error (not Ctrl-C, after which a run is resumed) before the
    first frame takes away what the block has made, and brings back what an earlier run that never ended had left.

    Where the folder already holds a result (`overwrite`), the new run grows in the sub-folder `unfinished`, and its
    files take the place of the old ones only when the block ends well with at least one frame. Everything else that
    belongs to the run (hand.json, config.yaml, overlay.mp4) is therefore to be written into `folder`, inside the block.

    With `resume`, `resume_point` tells where to go on: after the last frame of which the tracker's state is known. The
    lines after it are dropped and tracked again from that state, so the result is that of an uninterrupted run. Of a
    finished run `is_finished` says that nothing is left to do. One that was asked for more frames goes on where it has
    kept its checkpoint (`keep_checkpoint`).

    Raises InputError where the folder cannot be used, the disk refuses, or the header is not that of the run to resume.
    """

    def __init__(
        self,
        out_dir: str | Path,
        header: TrackHeader,
        *,
        resume: bool = False,
        overwrite: bool = False,
        checkpoint_every: int = 30,
        keep_checkpoint: bool = False,
        end: int | None = None,
    ) -> None:
        """keep_checkpoint: when the run has ended well. end: number of the frame after the last one that is wanted;
        None where all are."""
        if checkpoint_every < 1:
            raise ValueError(f"checkpoint_every: expected 1 or more frames, got {checkpoint_every}")
        self.out_dir = Path(out_dir)
        check_output_folder(self.out_dir, resume=resume, overwrite=overwrite)
        self.folder = self._choose_folder(resume)
        """Where the files of this run are until it has ended well."""
        self.resume_point: ResumePoint | None = None
        self.note: str | None = None
        """Why an interrupted run is begun anew, for the user."""
        self.is_finished = False
        """Whether the run that is to be resumed has nothing left to do; no frame may be added then."""
        self._header, self._every, self._end = header.as_json(), checkpoint_every, end
        self._keeps_checkpoint = keep_checkpoint
        self._last_frame = -1
        self._frames = 0
        self._has_corrections = False
        self._pending_state: Callable[[], State] | None = None
        self._made = [folder for folder in (self.folder, *self.folder.parents) if not folder.exists()]
        with explained_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / JSONL_NAME
        size = 0
        if not resume:
            self._set_aside()
        elif path.exists():
            size = self._resume(path)
        self._before = {entry.name for entry in self.folder.iterdir()}
        if not size:
            write_header(self.folder, self._header)
        self._lines = LineFile(path, size=size)

    def append(self, record: FrameRecord, state: Callable[[], State] | None = None) -> None:
        """Add one frame; frames come in increasing order.

        `state` gives the tracker's state after this frame; it is called now and then, and after the last frame, so it
        must describe the tracker as it is at the time of the call.
        """
        if record.frame <= self._last_frame:
            raise ValueError(f"frame: expected more than {self._last_frame}, got {record.frame}")
        self._write(record)
        if not self._frames:
            self._drop_aside()
        self._last_frame = record.frame
        self._frames += 1
        self._pending_state = state
        if state is not None and self._frames % self._every == 0:
            self._save_checkpoint(state)

    def correct(self, record: FrameRecord) -> None:
        """Put another record in the place of that of an earlier frame.

        What is corrected because of a later frame is to be written before that one is added: a run that is resumed
        after it then has it.
        """
        if record.frame > self._last_frame:
            raise ValueError(f"frame: expected at most {self._last_frame}, got {record.frame}")
        self._write(record)
        self._has_corrections = True

    def keep_forward(self) -> None:
        """Keep the lines of all frames as they are, before they are corrected by a backward pass: a run that is stopped
        in it, or resumed after it, goes on from these."""
        if self._pending_state is not None:
            self._save_checkpoint(self._pending_state)
        self._lines.sync()
        with replacing(self.folder / FORWARD_NAME) as temporary:
            shutil.copyfile(self.folder / JSONL_NAME, temporary)

    @contextlib.contextmanager
    def lines_beside(self, name: str) -> Iterator[LineFile]:
        """A new file of lines under the same header, which `load_track` reads by its path."""
        lines = LineFile(self.folder / name, size=0)
        try:
            yield lines
        finally:
            lines.close()

    def drop(self, name: str) -> None:
        """Take such a file away."""
        with explained_errors(self.folder):
            (self.folder / name).unlink(missing_ok=True)

    def _write(self, record: FrameRecord) -> None:
        if len(record.pose) != len(self._header["dof_names"]):
            raise ValueError(f"pose: expected {len(self._header['dof_names'])} DOFs, got {len(record.pose)}")
        self._lines.append(record.as_json())

    def __enter__(self) -> "TrackWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            try:
                self._finish()
            finally:
                self._lines.close()
            return
        # The first error is the one to report: what cannot be saved on top of it is left.
        with contextlib.suppress(InputError):
            self._lines.close()
        if self._frames:
            with contextlib.suppress(InputError):
                write_npz(load_track(self.folder), self.folder / NPZ_NAME)  # the longer of lines and arrays
        elif issubclass(kind, Exception):
            with contextlib.suppress(OSError):
                self._leave_as_before()

    def _leave_as_before(self) -> None:
        """Take away the files of this run, and the folders that were made for them; bring back those set aside."""
        for name in _result_names(self.folder):
            if name not in self._before:
                (self.folder / name).unlink(missing_ok=True)
        if self._aside.exists():
            for entry in self._aside.iterdir():
                os.replace(entry, self.folder / entry.name)
            self._aside.rmdir()
        for folder in self._made:
            folder.rmdir()

    def _finish(self) -> None:
        if self._frames:
            if self._pending_state is not None and self._keeps_checkpoint:
                self._save_checkpoint(self._pending_state)
            self._lines.sync()
            self._lines.close()
            if self._has_corrections:
                keep_last_lines(self.folder / JSONL_NAME)
            end = -1 if self._end is None else self._end
            write_npz(load_track(self.folder / JSONL_NAME), self.folder / NPZ_NAME, wanted_end=end)
            if not self._keeps_checkpoint:
                self.drop(CHECKPOINT_NAME)
        if self.folder == self.out_dir or not (self._frames or self.is_finished):
            return
        kept = [name for name in _result_names(self.folder) if (self.folder / name).exists()]
        replace_result(self.out_dir, self.folder, kept, [name for name in TRACK_NAMES if name not in kept])

    def _choose_folder(self, resume: bool) -> Path:
        if resume:
            folder = unfinished_run(self.out_dir) or self.out_dir
            entries = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
            own = _result_names(folder)
            foreign = [name for name in entries if name not in own and not name.startswith(".")]
            if foreign and JSONL_NAME not in entries:
                raise InputError(f"{folder}: cannot be resumed: expected {JSONL_NAME}, found {foreign[0]}")
            return folder
        has_result = any((self.out_dir / name).exists() for name in _result_names(self.out_dir))
        return self.out_dir / UNFINISHED_NAME if has_result else self.out_dir

    @property
    def _aside(self) -> Path:
        return self.folder / _ASIDE_NAME

    def _set_aside(self) -> None:
        """Keep what an earlier run that never ended has left, until this one has a frame."""
        self._drop_aside()
        with explained_errors(self.folder):
            left = [name for name in _result_names(self.folder) if (self.folder / name).exists()]
            for name in left:
                self._aside.mkdir(exist_ok=True)
                os.replace(self.folder / name, self._aside / name)

    def _drop_aside(self) -> None:
        if self._aside.exists():
            remove_entry(self._aside)

    def _resume(self, path: Path) -> int:
        """Find the point to go on from; returns how many bytes of the file stay."""
        check_header(path, self._header)
        if not (self.folder / CHECKPOINT_NAME).exists() and self._has_ended(path):
            self.is_finished = True
            return path.stat().st_size
        checkpoint, problem = load_checkpoint(self.folder / CHECKPOINT_NAME, self._header)
        if checkpoint is not None:
            self._check_end(checkpoint.last_frame)
        forward = self.folder / FORWARD_NAME
        if forward.exists():
            with explained_errors(self.folder):
                os.replace(forward, path)
        if checkpoint is None:
            if any(True for _ in read_lines(path)):
                self.note = f"{problem}; tracking from the first frame"
            return 0
        frames: set[int] = set()
        for lines, (record, end) in enumerate(read_lines(path), start=1):
            frame = record.get("frame")
            if not isinstance(frame, int):
                self.note = f"{path}, line {lines}: is damaged; tracking from the first frame"
                return 0
            frames.add(frame)
            if frame == checkpoint.last_frame:
                self.resume_point, self._last_frame, self._frames = checkpoint, frame, len(frames)
                self._has_corrections = lines > len(frames)
                return end
        return 0

    def _has_ended(self, path: Path) -> bool:
        """Whether these lines are those of a run that has ended well. Raises InputError where it was asked for other
        frames than are wanted now."""
        ended = wanted_end_of(self.folder / NPZ_NAME, path)
        if ended is None:
            return False
        last, end = ended
        self._check_end(last)
        if last + 1 == end and self._end != end:  # what comes after it has not been asked for
            raise InputError(
                f"{self.folder}: cannot be resumed: is finished with frame {last}, the last one that was wanted, and"
                " has not kept what more would go on from (--keep-checkpoint); give --overwrite"
            )
        return True

    def _check_end(self, last: int) -> None:
        """Raise InputError where fewer frames are wanted than are done."""
        if self._end is not None and last >= self._end:
            raise InputError(
                f"{self.folder}: cannot be resumed: frame {last} is done, and the last one that is"
                f" wanted is {self._end - 1}; give a larger --max-frames, or --overwrite"
            )

    def _save_checkpoint(self, state: Callable[[], State]) -> None:
        point = ResumePoint(last_frame=self._last_frame, state=state())
        save_checkpoint(self.folder / CHECKPOINT_NAME, point, self._header)
        self._pending_state = None


def _result_names(*folders: Path) -> list[str]:
    """Names of the files that a run may leave in some folders."""
    entries = {entry.name for folder in folders if folder.is_dir() for entry in folder.iterdir()}
    return [*sorted(name for name in entries if _DETECTED_ARRAYS.fullmatch(name)), *TRACK_NAMES]


def check_header(path: Path, header: Mapping[str, Any]) -> None:
    """Raise InputError where the lines of an interrupted run were begun with another header than the given one."""
    before = read_header(path)
    for key, value in header.items():
        if before.get(key) != value:
            raise InputError(
                f"{path}: cannot be resumed: {_difference(key, before.get(key), value)};"
                " give the same options as before, or --overwrite"
            )


def _difference(key: str, before: Any, now: Any) -> str:
    """The first thing that differs between two header values, by its dotted name."""
    if isinstance(before, dict) and isinstance(now, dict):
        for name in [*before, *(name for name in now if name not in before)]:
            if before.get(name) != now.get(name):
                return _difference(f"{key}.{name}", before.get(name), now.get(name))
    return f"{key} was {short(before)}, is now {short(now)}"
