"""What tells one input from another that has its name: sizes, times and first bytes of its files."""

import hashlib
import re
from pathlib import Path
from typing import Any

from torchhand.errors import InputError
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
            told = path.stat()
            digest.update(
                f"{path.relative_to(source)}\0{told.st_size}\0{told.st_mtime_ns}\0".encode("utf-8", "replace")
            )
        return {"files": len(files), "names_sizes_times": digest.hexdigest()}
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror or error})") from error


def _is_seen(path: Path) -> bool:
    is_named = path.suffix.lower() in PICTURE_SUFFIXES + VIDEO_SUFFIXES and not path.name.startswith(".")
    return is_named and path.is_file()
