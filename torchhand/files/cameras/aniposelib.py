"""Cameras from the TOML files of aniposelib (Anipose, Pose2Sim and their like): a table for each camera."""

import re
import tomllib
from pathlib import Path
from typing import Any

import torch

from torchhand.errors import InputError
from torchhand.files.disk import read_numbers, read_text, short
from torchhand.geometry import DISTORTION_LENGTHS, rotation_from_vector

_KEYS = ("name", "size", "matrix", "distortions", "rotation", "translation")
_SHOWN = 60  # characters of a name, in messages
_CAMERA = re.compile(r"cam[_-]?\w*", re.IGNORECASE)


def aniposelib_entries(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """The cameras of a file in its order: where each stands (for messages), and its entry as in a cameras.json.

    A table is a camera that has a matrix: size (width, height in px), matrix (3 x 3), distortions (OpenCV's order),
    rotation (a rotation vector) and translation, world to camera; its name is that of the table where it tells none.

    Raises InputError naming the file, the table and the key.
    """
    text = read_text(path, "a TOML text file")
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is no TOML that can be read ({error})") from error
    tables = {
        name: table
        for name, table in content.items()
        if isinstance(table, dict) and ("matrix" in table or _CAMERA.fullmatch(name))
    }
    if not tables:
        found = ", ".join(content) or "nothing"
        raise InputError(
            f"{path}: expected tables of cameras ([cam_0] with {', '.join(_KEYS[1:])}), got {short(found)}"
        )
    named = [(f"{path}: {name[:_SHOWN]}", name, table) for name, table in tables.items()]
    return [(where, _entry(where, name, table)) for where, name, table in named]


def _entry(where: str, name: str, table: dict[str, Any]) -> dict[str, Any]:
    missing = [key for key in _KEYS[1:] if key not in table]
    if missing:
        raise InputError(f"{where}: lacks {', '.join(missing)}; expected {', '.join(_KEYS)}")
    if table.get("fisheye", False):
        raise InputError(f"{where}: fisheye: expected a camera of OpenCV's usual model, got a fisheye camera")
    width, height = read_numbers(f"{where}: size", table["size"], (2,))
    turn = torch.tensor(read_numbers(f"{where}: rotation", table["rotation"], (3,)), dtype=torch.float64)
    distortions = table["distortions"]
    if not isinstance(distortions, list) or len(distortions) not in DISTORTION_LENGTHS:
        allowed = ", ".join(map(str, DISTORTION_LENGTHS))
        raise InputError(f"{where}: distortions: expected a list of {allowed} numbers, got {short(distortions)}")
    return {
        "name": str(table.get("name", name)) or name,
        "width": width,
        "height": height,
        "K": read_numbers(f"{where}: matrix", table["matrix"], (3, 3)),
        "R": rotation_from_vector(turn).tolist(),
        "t": read_numbers(f"{where}: translation", table["translation"], (3,)),
        "distortion": distortions,
    }
