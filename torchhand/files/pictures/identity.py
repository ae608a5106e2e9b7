"""What tells one input from another that has its name: sizes, times and first bytes of its files."""

import hashlib
import re
from pathlib import Path
from typing import Any

from torchhand.errors import InputError
from torchhand.files.disk import check_plain_file, expanded
from torchhand.files.pictures.pictures import PICTURE_SUFFIXES
from torchhand.files.pictures.video import VIDEO_SUFFIXES

_FIRST_BYTES = 1 << 20
_OF_A_RIG = re.compile(r"(view|masks)_\d+", re.IGNORECASE)


def input_identity(source: str | Path) -> dict[str, Any]:
    """Of a video or a picture its size and a hash of its beginning; of a folder the number of its pictures and videos
    and a hash of their names, sizes and times; nothing of a webcam, which is given as a text.

    Raises InputError where the disk refuses.
    """
    if isinstance(source, str):
        return {}
    digest = hashlib.sha256()
    try:
        if not source.is_dir():
            with source.open("rb") as file:
                digest.update(file.read(_FIRST_BYTES))
            return {"bytes": source.stat().st_size, "first_bytes": digest.hexdigest()}
        folders = [source, *sorted(p for p in source.iterdir() if _OF_A_RIG.fullmatch(p.name) and p.is_dir())]
        files = [path for folder in folders for path in sorted(folder.iterdir()) if _is_seen(path)]
        for path in files:
            digest.update(_named(path, source))
        return {"files": len(files), "names_sizes_times": digest.hexdigest()}
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror or error})") from error


def file_identity(path: Path) -> dict[str, Any]:
    """Of a file that a run uses beside its input its name and a hash of its content; of a folder its name and a hash of
    the names, sizes and times of its files.

    Raises InputError where the disk refuses.
    """
    digest, path = hashlib.sha256(), expanded(path)
    try:
        if not path.is_dir():
            check_plain_file(path)
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256")
            return {"name": str(path), "content": digest.hexdigest()}
        for file in sorted(entry for entry in path.iterdir() if entry.is_file()):
            digest.update(_named(file, path))
        return {"name": str(path), "names_sizes_times": digest.hexdigest()}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def _named(file: Path, folder: Path) -> bytes:
    told = file.stat()
    return f"{file.relative_to(folder)}\0{told.st_size}\0{told.st_mtime_ns}\0".encode("utf-8", "replace")


def _is_seen(path: Path) -> bool:
    is_named = path.suffix.lower() in PICTURE_SUFFIXES + VIDEO_SUFFIXES and not path.name.startswith(".")
    return is_named and path.is_file()
