"""A new result in the place of an old one, as one step: from a marker on the new one counts, however the program ends.

Files are moved one by one. A program that is killed between two moves leaves the marker, and whoever reads the folder
next finishes the moves first.
"""

import contextlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchhand.errors import InputError
from torchhand.files.disk import explained_errors, read_lines, write_text

_MARKER = "complete.json"


def replace_result(old: Path, new: Path, kept: Sequence[str], dropped: Sequence[str]) -> None:
    """Move the files, and folders of files, `kept` of the folder `new` into `old`, and remove those `dropped` from it.

    Raises InputError where the disk refuses.
    """
    write_text(new / _MARKER, json.dumps({"kept": [*kept], "dropped": [*dropped]}) + "\n")
    finish_replacement(old, new)


def finish_replacement(old: Path, new: Path) -> None:
    """Finish a replacement that was begun; nothing happens where none was. Raises InputError where the disk refuses."""
    marker = new / _MARKER
    if not marker.is_file():
        return
    with explained_errors(old):
        told = next((record for record, _ in read_lines(marker)), {})
        for name in _names(told.get("dropped")):
            remove_entry(old / name)
        for name in _names(told.get("kept")):
            if (new / name).exists():
                if (old / name).is_dir():
                    remove_entry(old / name)
                os.replace(new / name, old / name)
        marker.unlink()
        with contextlib.suppress(OSError):
            new.rmdir()  # stays where someone else has put a file there


def _names(told: Any) -> list[str]:
    """Those of the marker's entries that name something within a folder; a foreign marker may hold anything."""
    names = told if isinstance(told, list) else []
    return [name for name in names if isinstance(name, str) and name == Path(name).name and name not in ("", "..")]


def remove_entry(path: Path) -> None:
    """Remove a file, or a folder of files; never what lies deeper. Raises InputError naming what that is."""
    if path.is_dir() and not path.is_symlink():
        for entry in path.iterdir():
            if entry.is_dir() and not entry.is_symlink():
                raise InputError(f"{entry}: cannot be removed (is a folder that is no part of a result; move it away)")
            entry.unlink()
        path.rmdir()
    else:
        path.unlink(missing_ok=True)
