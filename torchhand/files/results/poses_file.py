"""The results of single pictures: a line each while a run goes on (poses.jsonl), arrays in the end (poses.npz)."""

import contextlib
import json
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float

from torchhand.errors import InputError
from torchhand.files.disk import LineFile, explained_errors, read_lines, replacing
from torchhand.files.results.replacement import remove_entry, replace_result
from torchhand.files.results.results import TRACK_NAMES, UNFINISHED_NAME, check_header, check_output_folder
from torchhand.files.results.track_file import FIT_NAME, HEADER_NAME, POSES_NAME, write_header
from torchhand.files.results.track_record import OF_PICTURES, FrameRecord, TrackHeader, track_of

POSES_LINES_NAME = "poses.jsonl"
OVERLAYS_NAME = "overlays"
_RESULT_NAMES = (
    OVERLAYS_NAME,
    HEADER_NAME,
    POSES_LINES_NAME,
    POSES_NAME,
)  # in the order in which they are moved into place
RESULT_NAMES = frozenset((*TRACK_NAMES, *_RESULT_NAMES, FIT_NAME))
"""Names of the files of all results."""


@dataclass(frozen=True, kw_only=True)
class PictureRecord:
    """What one picture gave."""

    image: str
    """Name of the picture."""
    hand: FrameRecord
    """Its hand, numbered as the picture is in its folder."""
    side: str
    shape: Float[np.ndarray, "shape"]
    """Proportions of the hand; NaN without one."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Intrinsics of the camera; NaN where the picture could not be read."""

    def as_json(self) -> str:
        """One line of strict JSON without its end."""
        own = {"image": self.image, "side": self.side, "shape": _listed(self.shape), "K": _listed(self.intrinsics)}
        return json.dumps(json.loads(self.hand.as_json()) | own, allow_nan=False, separators=(",", ":"))


class PosesWriter:
    """Writes the results of single pictures; use it as a context manager around the whole run.

    header.json is written once; poses.jsonl grows by a line per picture. Leaving the block well writes poses.npz: the
    arrays of track.npz, and of every picture its name (`image`), the `side`, the `shape` with `shape_names`, and the
    intrinsics `K`. Leaving it by an exception keeps the lines. Where the folder holds results already (`overwrite`),
    the new run grows in the sub-folder `unfinished`, and takes their place only when it ends well, as one step.
    `resume` goes on after the pictures that are `done`.

    Raises InputError where the folder cannot be used, the disk refuses, or the header is not that of the run to resume.
    """

    def __init__(
        self,
        out_dir: Path,
        header: TrackHeader,
        shape_names: tuple[str, ...],
        *,
        resume: bool = False,
        overwrite: bool = False,
    ) -> None:
        check_output_folder(out_dir, resume=resume, overwrite=overwrite)
        self.out_dir, self._shape_names = out_dir, shape_names
        self._header = header.as_json()
        unfinished = out_dir / UNFINISHED_NAME
        has_result = any((out_dir / name).exists() for name in _RESULT_NAMES)
        is_replacing = (unfinished / POSES_LINES_NAME).exists() if resume else has_result
        self.folder = unfinished if is_replacing else out_dir
        """Where the files of this run are until it has ended well."""
        self.done: frozenset[str] = frozenset()
        """Names of the pictures whose results stand in the file."""
        if overwrite and (out_dir / OVERLAYS_NAME).exists() and not (out_dir / POSES_LINES_NAME).is_file():
            raise InputError(f"{out_dir}: expected results of fit_pose to replace, got other {OVERLAYS_NAME}")
        with explained_errors(self.folder):
            if self.folder == unfinished and not resume:
                for name in _RESULT_NAMES:
                    remove_entry(unfinished / name)
            self.overlays.mkdir(parents=True, exist_ok=True)
        path = self.folder / POSES_LINES_NAME
        size = self._resumed(path) if resume and path.exists() else 0
        if not size:
            write_header(self.folder, self._header)
        self._lines = LineFile(path, size=size)

    @property
    def overlays(self) -> Path:
        """Folder for one picture of each hand."""
        return self.folder / OVERLAYS_NAME

    def append(self, record: PictureRecord) -> None:
        """Add one picture."""
        self._lines.append(record.as_json())

    def __enter__(self) -> "PosesWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:  # the first error is the one to report
            with contextlib.suppress(InputError):
                self._lines.close()
            return
        try:
            self._lines.sync()
        finally:
            self._lines.close()
        self._write_arrays()
        with explained_errors(self.out_dir):
            if not any(self.overlays.iterdir()):
                self.overlays.rmdir()
        if self.folder != self.out_dir:
            kept = [name for name in _RESULT_NAMES if (self.folder / name).exists()]
            replace_result(self.out_dir, self.folder, kept, [name for name in _RESULT_NAMES if name not in kept])

    def _write_arrays(self) -> None:
        rows = [record for record, _ in read_lines(self.folder / POSES_LINES_NAME)]
        rows = sorted({row["image"]: row for row in rows}.values(), key=lambda row: row["frame"])
        track = track_of(self._header, [{k: v for k, v in row.items() if k not in OF_PICTURES} for row in rows])
        arrays = track.arrays() | {
            "image": np.array([row["image"] for row in rows], np.str_),
            "side": np.array([row["side"] for row in rows], np.str_),
            "shape": np.array([row["shape"] for row in rows], np.float64).reshape(len(rows), len(self._shape_names)),
            "shape_names": np.array(self._shape_names),
            "K": np.array([row["K"] for row in rows], np.float64).reshape(len(rows), 3, 3),
        }
        with replacing(self.folder / POSES_NAME) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)  # pyright: ignore[reportArgumentType] - the stub lacks keyword arrays

    def _resumed(self, path: Path) -> int:
        """Find the pictures that are done; returns how many bytes of the file stay."""
        check_header(path, self._header)
        size, done = 0, list[str]()
        for record, end in read_lines(path):
            done.append(str(record.get("image")))
            size = end
        self.done = frozenset(done)
        return size


def _listed(values: np.ndarray) -> Any:
    """Nested lists with None for what is not finite."""
    boxed = values.astype(object)
    boxed[~np.isfinite(values)] = None
    return boxed.tolist()
