"""Cameras from OpenCV's FileStorage files (YAML or XML): one camera, several, or a stereo pair."""

import re
from pathlib import Path
from typing import Any

import cv2
import torch

from torchhand.errors import InputError
from torchhand.files.disk import quiet_opencv, read_text, short
from torchhand.geometry import rotation_from_vector

OPENCV_SUFFIXES = (".yml", ".yaml", ".xml")

# Spellings in use, small letters and digits only.
_MEANINGS = {
    "K": ("cameramatrix", "k", "m", "intrinsic", "intrinsics", "intrinsicmatrix"),
    "distortion": ("distortioncoefficients", "distortioncoeffs", "distortion", "distcoeffs", "dist", "d"),
    "R": ("r", "rotation", "rotationmatrix", "rvec", "rot"),
    "t": ("t", "translation", "translationvector", "tvec", "trans"),
    "width": ("imagewidth", "width"),
    "height": ("imageheight", "height"),
    "size": ("imagesize", "size", "resolution"),
    "name": ("cameraname", "name"),
}
_MEANING_OF = {word: meaning for meaning, words in _MEANINGS.items() for word in words}
_SHOWN = 60  # characters of a name, in messages
_NUMBERED = re.compile(r"(.*?)[_\-. ]?(\d+)")

Entry = tuple[str, dict[str, Any]]
"""Where a camera stands (for messages), and its entry in the manner of cameras.json."""


def opencv_entries(path: Path, *, size: tuple[int, int] | None = None) -> list[Entry]:
    """The cameras of one file, in its order.

    A camera is a mapping with camera_matrix (or K), distortion_coefficients (or D), R (3 x 3 or a rotation vector) and
    T, image_width and image_height (or image_size). The file is one such mapping; or holds several, each under its name
    or in a list; or numbers the keys (K_0, R_0, K_1, ...). With numbered K and a single R and T for two cameras it is
    what OpenCV's stereo calibration gives: from the first camera to the second, which makes the first one the world.
    size: width and height in px where the file does not tell.

    Raises InputError naming the file and key.
    """
    root = read_storage(path)
    shared = _meanings(root)
    if "K" in shared:
        return [_entry(str(path), shared, {}, size, name=path.stem, is_alone=True)]
    groups = _groups(root)
    if not groups:
        keys = ", ".join(root) or "nothing"
        raise InputError(f"{path}: expected a camera_matrix (or K), alone or per camera, got {short(keys)}")
    found = {name: group for name, group in groups.items() if "K" in group}
    for name, group in groups.items():
        if name not in found and "R" in group:
            raise InputError(f"{path}: {name[:_SHOWN]}: lacks camera_matrix (or K)")
    is_pair = len(found) == 2 and "R" in shared and "t" in shared and not any("R" in g for g in found.values())
    entries = []
    for i, (name, group) in enumerate(found.items()):
        if is_pair and i == 1:
            group = group | {"R": shared["R"], "t": shared["t"]}
        alone = len(found) == 1 or (is_pair and i == 0)
        entries.append(_entry(f"{path}: {name[:_SHOWN]}", group, shared, size, name=name, is_alone=alone))
    return entries


def read_storage(path: Path) -> dict[str, Any]:
    """A FileStorage file as dictionaries, lists (matrices: lists of rows), numbers and texts."""
    text = read_text(path, "a YAML or XML text file")
    if not text.strip():
        raise InputError(f"{path}: is empty")
    with quiet_opencv():
        storage = cv2.FileStorage()
        try:
            is_open = storage.open(_with_directive(text), cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
        except (cv2.error, SystemError) as error:
            lines = str(error.__cause__ or error).strip().splitlines()
            reason = lines[-1].rpartition("error: ")[2][:120]
            raise InputError(f"{path}: is no OpenCV YAML or XML that can be read ({reason})") from error
        if not is_open:
            raise InputError(f"{path}: is no OpenCV YAML or XML that can be read")
        root = storage.root()
        content = {key: _plain(f"{path}: {key}", root.getNode(key)) for key in root.keys()}  # noqa: SIM118
        storage.release()
    return content


def _with_directive(text: str) -> str:
    """YAML with the directive in its first line without which OpenCV 4 takes it for nothing that it knows."""
    is_marked = text.lstrip().startswith(("%YAML", "<", "{"))
    return text if is_marked or int(cv2.__version__.split(".")[0]) >= 5 else f"%YAML:1.0\n---\n{text}"


def _plain(where: str, node: Any) -> Any:
    if node.isMap():
        content = {key: _plain(f"{where}.{key}", node.getNode(key)) for key in node.keys()}  # noqa: SIM118
        if {"sizes", "data"} <= set(content):  # a matrix whose dimensions are not two
            sizes = content["sizes"] if isinstance(content["sizes"], list) else []
            content |= {"rows": 1, "cols": sizes[0]} if len(sizes) == 1 else {}
        return _matrix(where, content) if {"rows", "cols", "data"} <= set(content) else content
    if node.isSeq():
        return [_plain(f"{where}[{i}]", node.at(i)) for i in range(node.size())]
    if node.isString():
        return node.string()
    return node.real() if node.isInt() or node.isReal() else None


def _matrix(where: str, content: dict[str, Any]) -> list[list[Any]]:
    rows, columns, data = content["rows"], content["cols"], content["data"]
    if not all(isinstance(count, int | float) and 0 <= count < 1e6 for count in (rows, columns)):
        raise InputError(f"{where}: expected numbers of rows and cols, got {short(rows)} and {short(columns)}")
    rows, columns = int(rows), int(columns)
    if not isinstance(data, list) or len(data) != rows * columns:
        got = len(data) if isinstance(data, list) else short(data)
        raise InputError(f"{where}: expected {rows * columns} numbers for {rows}x{columns}, got {got}")
    return [data[i * columns : (i + 1) * columns] for i in range(rows)]


def _meanings(content: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in content.items():
        meaning = _MEANING_OF.get(_plain_word(key))
        if meaning is not None:
            found.setdefault(meaning, value)
    return found


def _plain_word(key: str) -> str:
    return re.sub(r"[^a-z0-9]", "", key.lower())


def _groups(root: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Mappings that may be cameras, by name: nested ones, those of lists, and those of numbered keys."""
    groups: dict[str, dict[str, Any]] = {}
    for key, value in root.items():
        if isinstance(value, dict):
            inner = _meanings(value)
            if "K" in inner or "R" in inner:
                groups[key] = inner
            else:
                groups |= _groups(value)
        elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            groups |= {str(_meanings(item).get("name", f"cam{i}")): _meanings(item) for i, item in enumerate(value)}
        elif number := _NUMBERED.fullmatch(key):
            meaning = _MEANING_OF.get(_plain_word(number[1]))
            if meaning is not None and isinstance(value, list):
                groups.setdefault(f"cam{int(number[2])}", {})[meaning] = value
    return groups


def _entry(
    where: str,
    found: dict[str, Any],
    shared: dict[str, Any],
    size: tuple[int, int] | None,
    *,
    name: str,
    is_alone: bool,
) -> Entry:
    """is_alone: no R and T are needed; the camera is the world then."""
    if not is_alone and not ("R" in found and "t" in found):
        missing = ", ".join(key for key, name in (("R", "R"), ("T", "t")) if name not in found)
        raise InputError(f"{where}: lacks {missing}; expected both for every camera of several")
    if ("R" in found) != ("t" in found):
        raise InputError(f"{where}: expected R and T, or neither, got only {'R' if 'R' in found else 'T'}")
    width, height = _size(where, found, shared, size)
    given = str(found.get("name") or name)
    return where, {
        "name": given,
        "width": width,
        "height": height,
        "K": found["K"],
        "R": _rotation(f"{where}: R", found.get("R")),
        "t": _flat(found.get("t"), [0.0, 0.0, 0.0]),
        "distortion": _flat(found.get("distortion"), []),
    }


def _size(where: str, found: dict[str, Any], shared: dict[str, Any], size: tuple[int, int] | None) -> tuple[Any, Any]:
    for group in (found, shared):
        if "width" in group and "height" in group:
            return group["width"], group["height"]
        pair = _flat(group.get("size"), [])
        if isinstance(pair, list) and len(pair) == 2:
            return pair[0], pair[1]
    if size is None:
        raise InputError(f"{where}: lacks the picture's size; expected image_width and image_height in px")
    return size


def _flat(value: Any, missing: list[float]) -> Any:
    """A row, a column or a list as a list; anything else as it is."""
    if value is None:
        return missing
    if isinstance(value, list) and any(isinstance(item, list) for item in value):
        return [number for row in value for number in (row if isinstance(row, list) else [row])]
    return value


def _rotation(where: str, value: Any) -> Any:
    if value is None:
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    numbers = _flat(value, [])
    if not isinstance(numbers, list) or not all(isinstance(number, float) for number in numbers):
        raise InputError(f"{where}: expected numbers, got {short(value)}")
    if len(numbers) == 3:
        matrix = rotation_from_vector(torch.tensor(numbers, dtype=torch.float64))
        return matrix.tolist()
    if len(numbers) == 9:
        return [numbers[0:3], numbers[3:6], numbers[6:9]]
    raise InputError(f"{where}: expected a 3x3 matrix or a rotation vector of 3 numbers, got {len(numbers)} numbers")
