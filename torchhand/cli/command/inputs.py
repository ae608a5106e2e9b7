"""What a command reads is not what it replaces."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

from torchhand.errors import InputError

_OUTPUTS = ("out", "overlay", "to")  # options that name what is written


def check_inputs_stay(given: Any) -> None:
    """Raise InputError where --overwrite would replace a file that the command is to read.

    given: the record of a command's arguments. Of a folder that is written to only files with the names of results are
    replaced; of folders that are read, and beside such files that are read, only these are read as results.
    """
    written = {name: path for name in _OUTPUTS if isinstance(path := getattr(given, name, None), Path)}
    if not getattr(given, "overwrite", False) or not written:
        return
    from torchhand.files.disk import expanded
    from torchhand.files.results import COMPARISON_NAME, OVERLAYS_NAME, REPORT_NAME, RESULT_NAMES, UNFINISHED_NAME

    own = [part for field in fields(given) if field.name not in _OUTPUTS for part in _paths(getattr(given, field.name))]
    read = [expanded(path) for path in own]
    files = {path.resolve() for path in read if path.is_file()}
    folders = {path.resolve() for path in read if path.is_dir()}
    folders |= {path.parent for path in files if path.name in RESULT_NAMES}
    for option, out in written.items():
        place = expanded(out).resolve()
        if option == "out" and place.is_dir():
            for path in sorted(files):
                is_result = path.parent == place and path.name in RESULT_NAMES
                if is_result or path.parent in (place / OVERLAYS_NAME, place / UNFINISHED_NAME):
                    raise InputError(f"--out: expected a folder that replaces no input, got {out}, with {path.name}")
        elif place in files:
            raise InputError(f"--{option}: expected a name other than that of an input, got {out}")
        elif place.parent in folders and place.name in {*RESULT_NAMES} - {REPORT_NAME, COMPARISON_NAME}:
            raise InputError(f"--{option}: expected a name other than those of the result that is an input, got {out}")


def _paths(value: Any) -> Iterator[Path]:
    """Names of files or folders among an option's values."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, str) and value and len(value) < 4096 and "\n" not in value:
        yield Path(value)
    elif isinstance(value, tuple | list):
        for part in value:
            yield from _paths(part)
