"""Reading text that a user may have written or broken: every mistake becomes one line naming the file and the line."""

import math
from pathlib import Path

from torchhand.errors import InputError
from torchhand.files.disk.json_checks import short
from torchhand.files.disk.plain_files import read_text

_LARGEST_BYTES = 1 << 30


def read_lines_of(path: Path, what: str) -> list[str]:
    """The lines of a text file. `what` is the kind of file that is expected, for the error."""
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise InputError(f"{path}: expected {what} of less than 1 GiB, got {path.stat().st_size} bytes")
    except OSError:
        pass  # the reading tells
    return read_text(path, f"{what}, a text file", missing="no such file").splitlines()


def finite(where: str, word: str) -> float:
    """The number that a word is; `where` names file and line."""
    try:
        number = float(word)
    except ValueError:
        raise InputError(f"{where}: expected a number, got {short(word)}") from None
    if not math.isfinite(number):
        raise InputError(f"{where}: expected a finite number, got {short(word)}")
    return number


def whole(where: str, word: str) -> int:
    """The whole number that a word is."""
    try:
        return int(word)
    except ValueError:
        raise InputError(f"{where}: expected a whole number, got {short(word)}") from None
