"""Writing files so that nothing half-written takes the place of something good."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from torchhand.errors import DiskError, InputError

_REASONS = {
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "the disk quota is used up",
    errno.EACCES: "no permission to write",
    errno.EPERM: "no permission to write",
    errno.EROFS: "the file system is read-only",
    errno.EISDIR: "is a folder",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.ENOENT: "no such folder",
}
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EIO)


@contextlib.contextmanager
def explained_errors(path: Path) -> Iterator[None]:
    """Turn an OSError inside the block into an InputError that names the file and the reason: a DiskError where the
    disk is full or failing."""
    try:
        yield
    except OSError as error:
        reason = _REASONS.get(error.errno or 0, error.strerror or str(error))
        kind = DiskError if error.errno in _DISK else InputError
        raise kind(f"{path}: cannot be written ({reason})") from error


def temporary_path(path: Path) -> Path:
    """The name beside `path` for its new content; the suffix stays, because it tells writers the format."""
    return path.with_name(f".{path.stem}.partial{path.suffix}")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path to write to, moved onto `path` when the block ends well and removed when it does not.

    Raises InputError where the disk refuses, and for what is no file, such as a device.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: expected a file to replace, got a device, a pipe or a socket")
    temporary = temporary_path(path)
    with explained_errors(path):
        try:
            yield temporary
            os.replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise


def write_text(path: Path, text: str) -> None:
    """Write a whole text file, or leave what was there and raise InputError."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
