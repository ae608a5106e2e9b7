"""The binary container of glTF 2.0: accessors are added one by one, then the whole is written as one .glb."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from torchhand.errors import InputError
from torchhand.files.disk import replacing

_MAGIC, _VERSION, _JSON_CHUNK, _BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_COMPONENTS = {"float32": 5126, "uint8": 5121, "uint16": 5123, "uint32": 5125}
_TYPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


class GlbContainer:
    """Collects the arrays of a glTF file. `content` is its JSON, to be filled by the caller."""

    def __init__(self) -> None:
        self.content: dict[str, Any] = {}
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []
        self._bytes = bytearray()

    @classmethod
    def read(cls, path: Path) -> "GlbContainer":
        """The content and the arrays of a binary glTF 2.0 file, to which others can be added.

        Raises InputError for another file, one that is cut short, and one whose arrays are in other files.
        """
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
        head = struct.Struct("<IIIII")
        if len(data) < head.size or head.unpack(data[: head.size])[::4] != (_MAGIC, _JSON_CHUNK):
            raise InputError(f"{path}: expected binary glTF (.glb), got something else")
        _, version, length, text, _ = head.unpack(data[: head.size])
        if version != _VERSION or length > len(data) or head.size + text > length:
            raise InputError(f"{path}: expected whole binary glTF of version {_VERSION}, got another or a cut file")
        try:
            content = json.loads(data[head.size : head.size + text])
        except ValueError as error:
            raise InputError(f"{path}: expected JSON in its first chunk, got something else ({error})") from error
        buffers = content.pop("buffers", [{}]) if isinstance(content, dict) else []
        if len(buffers) != 1 or "uri" in buffers[0]:
            raise InputError(f"{path}: expected all arrays in the file itself, got {len(buffers)} buffers or others")
        glb = cls()
        glb._views, glb._accessors = content.pop("bufferViews", []), content.pop("accessors", [])
        glb._bytes = bytearray(data[head.size + text + 8 : length])
        glb.content = content
        return glb

    def add(self, array: np.ndarray, *, target: int | None = None, has_bounds: bool = False) -> int:
        """Index of the accessor of an array (count, ...); matrices are given row by row and stored by columns.

        target: what the GPU uses it for, of vertices and indices. has_bounds: state least and largest values.
        """
        kind = _TYPES[array.shape[1:]]
        stored = np.ascontiguousarray(array.swapaxes(1, 2) if kind == "MAT4" else array)
        self._bytes += b"\0" * (-len(self._bytes) % 4)
        view = {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": stored.nbytes}
        self._views.append(view | ({} if target is None else {"target": target}))
        self._bytes += stored.tobytes()
        accessor: dict[str, Any] = {"bufferView": len(self._views) - 1, "count": len(array), "type": kind}
        accessor["componentType"] = _COMPONENTS[str(array.dtype)]
        if has_bounds:
            flat = array.reshape(len(array), -1)
            accessor |= {"min": flat.min(0).tolist(), "max": flat.max(0).tolist()}
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def write(self, path: Path) -> None:
        """Write the file, or leave what was there and raise InputError."""
        binary = bytes(self._bytes) + b"\0" * (-len(self._bytes) % 4)
        content = self.content | {
            "buffers": [{"byteLength": len(binary)}],
            "bufferViews": self._views,
            "accessors": self._accessors,
        }
        text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + len(binary)
        with replacing(path) as temporary, temporary.open("wb") as file:
            file.write(struct.pack("<III", _MAGIC, _VERSION, length))
            file.write(struct.pack("<II", len(text), _JSON_CHUNK) + text)
            file.write(struct.pack("<II", len(binary), _BINARY_CHUNK) + binary)
