"""Cameras from plain text files: cK.dat with K and distortion, rot_trans_cK.dat with R and T, per camera number K."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torchhand.errors import InputError
from torchhand.files.disk import read_text, short
from torchhand.files.pictures import natural_key

_LENS_FILE = re.compile(r"c(\d+)\.dat")


def lens_files(folder: Path) -> list[Path]:
    """The files cK.dat of a folder in natural order."""
    return sorted((path for path in folder.glob("c*.dat") if _LENS_FILE.fullmatch(path.name)), key=natural_key)


def plain_text_entries(
    folder: Path, size_of: Callable[[int, int], tuple[int, int]]
) -> list[tuple[str, dict[str, Any]]]:
    """Cameras camK of a folder in the manner of cameras.json.

    A file holds titles ("intrinsic:", "distortion:"; "R:", "T:") with numbers below, in rows or not; "#" begins a
    comment. Where a title comes twice the first counts. size_of(k, n) gives width and height of the kth of n cameras,
    which the files do not tell.

    Raises InputError naming file and title.
    """
    paths = lens_files(folder)
    entries = []
    for i, path in enumerate(paths):
        number = path.stem[1:]
        lens, pose = _sections(path), _sections(folder / f"rot_trans_c{number}.dat")
        width, height = size_of(i, len(paths))
        entry = {
            "name": f"cam{number}",
            "width": width,
            "height": height,
            "K": _square(_numbers(path, lens, "intrinsic", (9,))),
            "distortion": _numbers(path, lens, "distortion", (0, 4, 5, 8, 12, 14)),
            "R": _square(_numbers(folder / f"rot_trans_c{number}.dat", pose, "R", (9,))),
            "t": _numbers(folder / f"rot_trans_c{number}.dat", pose, "T", (3,)),
        }
        entries.append((str(path), entry))
    return entries


def _sections(path: Path) -> dict[str, list[float]]:
    """Numbers under each title, titles in small letters."""
    text = read_text(path, missing="no such file (expected cK.dat and rot_trans_cK.dat for every camera K)")
    sections: dict[str, list[float]] = {}
    numbers: list[float] = []
    for i, line in enumerate(text.splitlines(), start=1):
        content = line.partition("#")[0].strip()
        if content.endswith(":"):
            numbers = []
            sections.setdefault(content[:-1].strip().lower(), numbers)
            continue
        for word in content.replace(",", " ").split():
            try:
                numbers.append(float(word))
            except ValueError:
                raise InputError(f"{path}, line {i}: expected numbers, got {short(content)}") from None
    return sections


def _numbers(path: Path, sections: dict[str, list[float]], title: str, counts: tuple[int, ...]) -> list[float]:
    numbers = sections.get(title.lower())
    if numbers is None:
        found = ", ".join(sections) or "none"
        raise InputError(f"{path}: lacks the title {title!r}; found: {found}")
    if len(numbers) not in counts:
        expected = " or ".join(map(str, counts))
        raise InputError(f"{path}: {title}: expected {expected} numbers, got {len(numbers)}")
    if not all(map(math.isfinite, numbers)):
        raise InputError(f"{path}: {title}: expected finite numbers, got {short(numbers)}")
    return numbers


def _square(numbers: list[float]) -> list[list[float]]:
    return [numbers[0:3], numbers[3:6], numbers[6:9]]
