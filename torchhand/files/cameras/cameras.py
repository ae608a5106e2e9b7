"""cameras.json: calibrated cameras to and from a file."""

import json
from os import PathLike
from pathlib import Path
from typing import Any

import torch

from torchhand.errors import InputError, require_kind
from torchhand.files.disk import read_json, read_numbers, short, suggestion, write_text
from torchhand.geometry import DISTORTION_LENGTHS, Camera, assumed_camera

CONVENTION = "OpenCV: x right, y down, z forward; X_cam = R X_world + t; metres; pixel centres at integers"

_REQUIRED = ("name", "width", "height", "K", "R", "t", "distortion")
_LONGEST_NAME = 100  # characters; names stand in messages, files' names and pictures
_KINDS = ("pinhole", "orthographic")
_ROTATION_TOLERANCE = 1e-4


def load_cameras(path: str | Path, *, dtype: torch.dtype = torch.float64) -> list[Camera]:
    """The cameras of a cameras.json, in its order.

    The file holds {"cameras": [{name, width, height, K (3 x 3), R (3 x 3), t (3), distortion}, ...]} with
    X_cam = R X_world + t, OpenCV's distortion order, and optionally "model": "pinhole" or "orthographic". Other keys
    are free for notes, unless one looks like a misspelt key of ours.

    Raises InputError naming the file, the camera and the key, what was expected and what was got.
    """
    path = Path(path)
    content = read_json(path)
    entries = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries:
        raise InputError(f'{path}: expected {{"cameras": [...]}} with at least one camera, got {short(content)}')
    cameras = [camera_of_entry(f"{path}: cameras[{i}]", entry, dtype=dtype) for i, entry in enumerate(entries)]
    names = [camera.name for camera in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: expected a different name for every camera, got {twice!r} twice")
    return cameras


def save_cameras(cameras: list[Camera], path: str | Path) -> None:
    """Write cameras as `load_cameras` reads them; float64 numbers come back bit for bit."""
    content = {"cameras": [camera_entry(camera) for camera in cameras], "convention": CONVENTION}
    write_text(Path(path), json.dumps(content, indent=1, allow_nan=False) + "\n")


def camera_entry(camera: Camera) -> dict[str, Any]:
    """One entry of cameras.json, of plain numbers, lists and texts."""
    if camera.rotation.ndim != 2:
        raise ValueError(f"camera: expected a single one, got a batch of shape {tuple(camera.rotation.shape[:-2])}")
    return {
        "name": camera.name,
        "model": camera.kind,
        "width": camera.width,
        "height": camera.height,
        "K": camera.intrinsics.tolist(),
        "R": camera.rotation.tolist(),
        "t": camera.translation.tolist(),
        "distortion": camera.distortion.tolist(),
    }


def only_camera(path: str | Path) -> Camera:
    """The camera of a file of one. Raises InputError if it cannot be read or holds more than one camera."""
    cameras = load_cameras(path)
    if len(cameras) != 1:
        names = ", ".join(camera.name for camera in cameras)
        raise InputError(f"{path}: expected one camera, got {len(cameras)} ({names})")
    return cameras[0]


def camera_for(given: Camera | str | Path | None, width: int, height: int) -> Camera:
    """The camera of pictures of the given size (px): the one that is given, or the only one of a file; an assumed one
    where nothing is given.

    Raises InputError if a file holds more than one camera, and for a camera of another picture size; TypeError for what
    is neither.
    """
    if given is None:
        return assumed_camera(width, height)
    require_kind("camera", given, Camera, str, PathLike)
    is_file = not isinstance(given, Camera)
    camera = only_camera(given) if is_file else given
    if (camera.width, camera.height) != (width, height):
        raise InputError(
            f"{given if is_file else 'camera'}: expected a camera of {width}x{height} px, the size of the pictures,"
            f" got {camera.width}x{camera.height}"
        )
    return camera


def camera_of_entry(where: str, entry: Any, *, dtype: torch.dtype = torch.float64) -> Camera:
    """The camera of one entry of a cameras.json; `where` names it in the InputError that a wrong one raises."""
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected an object with {', '.join(_REQUIRED)}, got {short(entry)}")
    missing = [key for key in _REQUIRED if key not in entry]
    if missing:
        raise InputError(f"{where}: lacks {', '.join(missing)}; expected {', '.join(_REQUIRED)}")
    known = (*_REQUIRED, "model")
    for key in entry:
        if key not in known and (hint := suggestion(key, known)):
            raise InputError(f"{where}: unknown key {key!r}{hint}; allowed: {', '.join(known)}")
    name, kind = entry["name"], entry.get("model", "pinhole")
    if not isinstance(name, str) or not name:
        raise InputError(f"{where}.name: expected a text, got {short(name)}")
    if len(name) > _LONGEST_NAME:
        raise InputError(f"{where}.name: expected a text of at most {_LONGEST_NAME} characters, got {len(name)}")
    if kind not in _KINDS:
        raise InputError(f"{where}.model: expected one of {', '.join(_KINDS)}, got {short(kind)}")
    distortion = entry["distortion"]
    if not isinstance(distortion, list) or len(distortion) not in DISTORTION_LENGTHS:
        got = len(distortion) if isinstance(distortion, list) else short(distortion)
        raise InputError(f"{where}.distortion: expected a list of {_choice(DISTORTION_LENGTHS)} numbers, got {got}")
    coefficients = read_numbers(f"{where}.distortion", distortion, (len(distortion),))
    if kind == "orthographic" and any(coefficients):
        raise InputError(f"{where}.distortion: expected none for an orthographic camera, got {short(distortion)}")
    return Camera(
        intrinsics=torch.tensor(_intrinsics(f"{where}.K", entry["K"]), dtype=dtype),
        rotation=torch.tensor(_rotation(f"{where}.R", entry["R"]), dtype=dtype),
        translation=torch.tensor(read_numbers(f"{where}.t", entry["t"], (3,)), dtype=dtype),
        distortion=torch.tensor(coefficients, dtype=dtype),
        width=_size(f"{where}.width", entry["width"]),
        height=_size(f"{where}.height", entry["height"]),
        kind=kind,
        name=name,
    )


def _intrinsics(where: str, value: Any) -> list[list[float]]:
    rows = read_numbers(where, value, (3, 3))
    for i in (0, 1):
        if rows[i][i] <= 0:
            raise InputError(f"{where}[{i}][{i}]: expected a positive focal length, got {rows[i][i]}")
    if rows[2] != [0.0, 0.0, 1.0] or rows[1][0] != 0.0:
        raise InputError(f"{where}: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]], got {short(value)}")
    return rows


def _rotation(where: str, value: Any) -> list[list[float]]:
    rows = read_numbers(where, value, (3, 3))
    matrix = torch.tensor(rows, dtype=torch.float64)
    error = float((matrix @ matrix.T - torch.eye(3, dtype=torch.float64)).abs().max())
    determinant = float(torch.linalg.det(matrix))
    if error > _ROTATION_TOLERANCE or determinant < 0:
        raise InputError(
            f"{where}: expected a rotation (R Rᵀ = 1 to {_ROTATION_TOLERANCE:g}, determinant +1),"
            f" got an error of {error:.2g} and determinant {determinant:.4g}"
        )
    return rows


def _size(where: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value // 1 or value < 1:
        raise InputError(f"{where}: expected a positive whole number of px, got {short(value)}")
    return int(value)


def _choice(numbers: tuple[int, ...]) -> str:
    return f"{', '.join(map(str, numbers[:-1]))} or {numbers[-1]}"
