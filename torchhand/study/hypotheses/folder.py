"""The folder of a hypothesis study: batches saved as they come, resumable, never worse than what was there before."""

import contextlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchhand.errors import InputError
from torchhand.files import check_output_folder
from torchhand.files.disk import explained_errors, opened_arrays, read_json, replacing, short, write_text
from torchhand.files.results import CONFIG_NAME, UNFINISHED_NAME, replace_result
from torchhand.study.hypotheses.batches import BatchFile
from torchhand.study.hypotheses.record import STATUS_NAMES, Hypotheses

CSV_NAME, NPZ_NAME, PICTURE_NAME, HEADER_NAME = "study.csv", "hypotheses.npz", "study.png", "header.json"
STUDY_FORMAT = "torchhand hypothesis study 3"
RESULT_NAMES = (CSV_NAME, PICTURE_NAME, NPZ_NAME)

_BATCHES_NAME = "batches.bin"
_OF_BEFORE = (CONFIG_NAME,)
"""Files of an older version's study, which are part of others now."""
_COMPLAINT = "is no hypothesis study that can be read"


class StudyFolder:
    """Where a study grows and ends.

    Batches are kept in one file of the sub-folder `unfinished`, so that whatever ends the program loses only what was
    under way. `finishing` moves the results into place as one step and takes the sub-folder away; until
    then an older result stays.
    """

    def __init__(self, out_dir: Path, header: Mapping[str, Any], *, resume: bool, overwrite: bool) -> None:
        """header: what must be equal in a study that is to be resumed, as JSON takes it.

        Raises InputError where the folder cannot be used, or holds another study than the one to resume.
        """
        check_output_folder(out_dir, resume=resume, overwrite=overwrite)
        self.out_dir, self.folder = out_dir, out_dir / UNFINISHED_NAME
        self.header = {"format": STUDY_FORMAT, **json.loads(json.dumps(dict(header)), parse_constant=str)}
        self.finished: Hypotheses | None = None
        """Of a study that is to be resumed and has nothing left to do."""
        if resume:
            self._check_same()
        else:
            self._clear()
        if self.finished is None:
            with explained_errors(self.folder):
                self.folder.mkdir(parents=True, exist_ok=True)
            write_text(self.folder / HEADER_NAME, json.dumps(self.header, indent=1) + "\n")
        self.batches = BatchFile(self.folder / _BATCHES_NAME)

    @contextlib.contextmanager
    def finishing(self) -> Iterator[Path]:
        """A folder for the results (RESULT_NAMES), moved into place when the block ends well."""
        yield self.folder
        replace_result(self.out_dir, self.folder, RESULT_NAMES, dropped=_OF_BEFORE)
        self._clear()

    def discard(self) -> None:
        """Take away what was begun; an older result stays."""
        self._clear()
        with contextlib.suppress(OSError):
            self.out_dir.rmdir()  # only where it is empty

    def _clear(self) -> None:
        with explained_errors(self.folder):
            # The header first: without it nothing was begun, whatever else is left.
            for name in (HEADER_NAME, *RESULT_NAMES, _BATCHES_NAME):
                (self.folder / name).unlink(missing_ok=True)
            for path in self.folder.glob(".*.partial.*"):
                path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                self.folder.rmdir()  # stays where someone else has put a file there

    def _check_same(self) -> None:
        begun = self.folder / HEADER_NAME
        if begun.exists():
            before, where = read_json(begun), begun
        elif (self.out_dir / NPZ_NAME).exists():
            where = self.out_dir / NPZ_NAME
            before, self.finished = load_study(where)
        else:
            names = sorted(path.name for path in self.out_dir.iterdir()) if self.out_dir.is_dir() else []
            foreign = [name for name in names if name != UNFINISHED_NAME]
            if foreign:
                raise InputError(f"{self.out_dir}: cannot be resumed: expected a study, found {foreign[0]}")
            return
        if before != self.header:
            raise InputError(
                f"{where}: cannot be resumed: {_difference('', before, self.header)};"
                " give the same options as before, or --overwrite"
            )


def save_study(path: Path, header: Mapping[str, Any], hypotheses: Hypotheses, further: Mapping[str, Any]) -> None:
    """Write hypotheses.npz; `further` adds arrays. The same content gives the same bytes."""
    arrays = hypotheses.arrays() | {"status": np.array(STATUS_NAMES)[hypotheses.status]}
    arrays |= {name: np.asarray(value) for name, value in further.items()} | {"header": np.array(json.dumps(header))}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType] - the stub lacks keyword arrays


def load_study(path: Path) -> tuple[dict[str, Any], Hypotheses]:
    """Header and hypotheses of a finished study. Raises InputError naming the file and what is wrong with it."""
    with opened_arrays(path, complaint=_COMPLAINT) as stored:
        arrays = dict(stored)
    try:
        header = json.loads(str(arrays["header"]))
        if header.get("format") != STUDY_FORMAT:
            raise ValueError(f"expected the format {STUDY_FORMAT!r}, got {short(header.get('format'))}")
        numbers = np.array([STATUS_NAMES.index(name) for name in arrays["status"].tolist()])
        return header, Hypotheses.from_arrays(arrays | {"status": numbers})
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: {_COMPLAINT} ({type(error).__name__}: {error})") from error


def _difference(key: str, before: Any, now: Any) -> str:
    """The first thing that differs between two headers, by its dotted name."""
    if isinstance(before, dict) and isinstance(now, dict):
        for name in [*before, *(name for name in now if name not in before)]:
            if before.get(name) != now.get(name):
                return _difference(f"{key}.{name}" if key else name, before.get(name), now.get(name))
    return f"{key} was {short(before)}, is now {short(now)}"
