"""Reading text that a user may have written or broken: every mistake becomes one line naming the file and the line."""

import math
from pathlib import Path

from torchhand.errors import InputError
from torchhand.files.disk.json_checks import short

_LARGEST_BYTES = 1 << 30


def read_lines_of(path: Path, what: str) -> list[str]:
    """The lines of a text file. `what` is the kind of file that is expected, for the error."""
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise InputError(f"{path}: expected {what} of less than 1 GiB, got {path.stat().st_size} bytes")
        return path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected {what}, a text file in UTF-8, got something else") from error


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
