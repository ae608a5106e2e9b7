"""Opening what a user names: regular files alone, never a device or a pipe, which may have no end or never begin."""

import os
import stat
from pathlib import Path

from torchhand.errors import InputError

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_text(path: Path, kind: str = "a text file", *, missing: str | None = None) -> str:
    """The text of a file in UTF-8, with or without a byte order mark. Raises InputError naming the file.

    kind: what is expected, in words. missing: what is said where there is no such file.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        if missing is not None and isinstance(error, FileNotFoundError):
            raise InputError(f"{path}: {missing}") from None
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected {kind} in UTF-8, got something else") from error


def check_plain_file(path: Path) -> int:
    """The size of a regular file, bytes; nothing is opened.

    Raises InputError where there is none, or something that is no file.
    """
    try:
        found = path.stat()
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    for is_kind, name in _KINDS:
        if is_kind(found.st_mode):
            raise InputError(f"{path}: cannot be read (expected a file, got {name})")
    return found.st_size


def read_plain_file(path: Path, *, largest: int) -> bytes:
    """The whole content of a regular file of at most `largest` bytes. Raises InputError naming it and the reason."""
    size = check_plain_file(path)
    if size > largest:
        raise InputError(f"{path}: expected a file of at most {largest >> 20} MiB, got {size >> 20} MiB")
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def check_name(path: str | os.PathLike[str]) -> None:
    """Raise InputError for a name that is no UTF-8: results could not hold it, and OpenCV ends the program over it."""
    text = os.fspath(path)
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        shown = text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
        raise InputError(f"{shown}: expected a name in UTF-8, got other bytes; rename it") from None


def expanded(path: str | os.PathLike[str]) -> Path:
    """The path with ~ for the home folder. Raises InputError where there is no such user."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise InputError(f"{path}: no such home folder; write ./~ for a name that begins so") from None
