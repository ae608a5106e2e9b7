"""A new result in the place of an old one, as one step: from a marker on the new one counts, however the program ends.

Files are moved one by one. A program that is killed between two moves leaves the marker, and whoever reads the folder
next finishes the moves first.
"""

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from torchhand.files.disk import explained_errors, read_lines, write_text

_MARKER = "complete.json"


def replace_result(old: Path, new: Path, kept: Sequence[str], dropped: Sequence[str]) -> None:
    """Move the files `kept` of the folder `new` into `old`, and remove those `dropped` from it.

    Raises InputError where the disk refuses.
    """
    write_text(new / _MARKER, f'{{"kept": {_listed(kept)}, "dropped": {_listed(dropped)}}}\n')
    finish_replacement(old, new)


def finish_replacement(old: Path, new: Path) -> None:
    """Finish a replacement that was begun; nothing happens where none was. Raises InputError where the disk refuses."""
    marker = new / _MARKER
    if not marker.is_file():
        return
    told = next((record for record, _ in read_lines(marker)), {})
    with explained_errors(old):
        for name in told.get("dropped", ()):
            (old / Path(name).name).unlink(missing_ok=True)
        for name in told.get("kept", ()):
            if (new / Path(name).name).exists():
                os.replace(new / Path(name).name, old / Path(name).name)
        marker.unlink()
        with contextlib.suppress(OSError):
            new.rmdir()  # stays where someone else has put a file there


def _listed(names: Sequence[str]) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"
