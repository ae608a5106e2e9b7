"""Cameras from a COLMAP text model: cameras.txt and images.txt."""

import math
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from torchhand.errors import InputError
from torchhand.files.disk import read_text, short

# Parameters after the focal lengths and the principal point become OpenCV's k1 k2 p1 p2.
_MODELS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8}
_HAS_TWO_FOCAL_LENGTHS = ("PINHOLE", "OPENCV")
_CENTRE_OF_FIRST_PIXEL = 0.5  # in COLMAP; 0 here


def colmap_entries(folder: Path) -> list[tuple[str, dict[str, Any]]]:
    """One camera per picture of images.txt, in the order of the picture names, in the manner of cameras.json.

    A picture is named by its folder where every picture has one of its own, else by its file name without suffix. The
    principal point is moved by half a pixel: the centre of COLMAP's first pixel is (0.5, 0.5). The scale of a COLMAP
    model is arbitrary.

    Raises InputError naming file and line.
    """
    lenses = dict(_lens(where, words) for where, words in _lines(folder / "cameras.txt") if words)
    pictures = list(_pictures(folder / "images.txt"))
    if not pictures:
        raise InputError(f"{folder / 'images.txt'}: expected at least one picture, got none")
    pictures.sort(key=lambda picture: picture[1]["name"])
    paths = [PurePosixPath(entry["name"]) for _, entry, _ in pictures]
    folders = [str(path.parent) for path in paths]
    has_folders = len(set(folders)) == len(folders) and "." not in folders
    entries = []
    for (where, entry, lens), path, parent in zip(pictures, paths, folders, strict=True):
        if lens not in lenses:
            known = ", ".join(sorted(lenses))
            raise InputError(f"{where}: expected a CAMERA_ID of {folder / 'cameras.txt'} ({known}), got {short(lens)}")
        entries.append((where, lenses[lens] | entry | {"name": parent if has_folders else path.stem}))
    return entries


def _lines(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Place and words of every line that is no comment; empty lines too, because images.txt needs them."""
    text = read_text(path, missing="no such file (a COLMAP text model has cameras.txt and images.txt)")
    for i, line in enumerate(text.splitlines(), start=1):
        if not line.lstrip().startswith("#"):
            yield f"{path}, line {i}", line.split()


def _lens(where: str, words: list[str]) -> tuple[str, dict[str, Any]]:
    if len(words) < 4:
        raise InputError(f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS..., got {short(' '.join(words))}")
    number, model = words[:2]
    if model not in _MODELS:
        raise InputError(f"{where}: camera model {short(model)} cannot be read; allowed: {', '.join(_MODELS)}")
    width, height, *values = (_number(where, word) for word in words[2:])
    if len(values) != _MODELS[model]:
        raise InputError(f"{where}: expected {_MODELS[model]} parameters of {model}, got {len(values)}")
    fx, fy, cx, cy, *lens = values if model in _HAS_TWO_FOCAL_LENGTHS else (values[0], *values)
    shift = _CENTRE_OF_FIRST_PIXEL
    return number, {
        "width": width,
        "height": height,
        "K": [[fx, 0.0, cx - shift], [0.0, fy, cy - shift], [0.0, 0.0, 1.0]],
        "distortion": [*lens, 0.0, 0.0, 0.0, 0.0][:4] if lens else [],
    }


def _pictures(path: Path) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Place, pose with the picture's name, and CAMERA_ID; every other line holds points and is passed over."""
    is_pose = True
    for where, words in _lines(path):
        if is_pose and not words:
            continue
        if is_pose:
            if len(words) < 10:
                expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
                raise InputError(f"{where}: expected {expected}, got {short(' '.join(words))}")
            w, x, y, z, *translation = (_number(where, word) for word in words[1:8])
            length = math.sqrt(w * w + x * x + y * y + z * z)
            if abs(length - 1) > 1e-3:
                raise InputError(f"{where}: expected a unit quaternion QW QX QY QZ, got one of length {length:.4g}")
            entry = {
                "name": " ".join(words[9:]),
                "R": _rotation(w / length, x / length, y / length, z / length),
                "t": translation,
            }
            yield where, entry, words[8]
        is_pose = not is_pose


def _number(where: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise InputError(f"{where}: expected a number, got {short(word)}") from None
    if not math.isfinite(value):
        raise InputError(f"{where}: expected a finite number, got {short(word)}")
    return value


def _rotation(w: float, x: float, y: float, z: float) -> list[list[float]]:
    """Rotation of a Hamilton unit quaternion."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
