"""The container of a pose stream: magic, version, lengths, checksum, and a header of which every entry is checked."""

import json
import struct
import zlib
from pathlib import Path
from typing import Any

from torchhand.errors import InputError
from torchhand.export.clip import Up
from torchhand.files.disk import read_number, read_numbers, short
from torchhand.hand import DOFS, Side

MAGIC, VERSION = b"THP", b"1"
_LENGTHS = struct.Struct("<III")
_LONGEST_HEADER = 1 << 20
_MAX_FRAMES = 10_000_000


def packed_file(header: bytes, stream: bytes) -> bytes:
    """The whole file."""
    body = header + stream
    return MAGIC + VERSION + _LENGTHS.pack(len(header), len(stream), zlib.crc32(body)) + body


def unpacked(path: Path, data: bytes) -> tuple[bytes, bytes]:
    """Header and stream as they are in the file.

    Raises InputError for another kind or version of file, one that is cut short or damaged.
    """
    start = len(MAGIC) + len(VERSION) + _LENGTHS.size
    if not data.startswith(MAGIC):
        raise InputError(f"{path}: expected a pose stream that begins with {MAGIC.decode()!r}, got {data[:3]!r}")
    if len(data) < start:
        raise InputError(f"{path}: is cut short: expected {start} bytes or more, got {len(data)}")
    version = data[len(MAGIC) : len(MAGIC) + len(VERSION)]
    if version != VERSION:
        raise InputError(f"{path}: expected a pose stream of version {VERSION.decode()}, got {version!r}")
    header, stream, checksum = _LENGTHS.unpack(data[start - _LENGTHS.size : start])
    body = data[start:]
    if len(body) != header + stream:
        fault = "is cut short" if len(body) < header + stream else "goes on after its end"
        raise InputError(f"{path}: {fault}: expected {start + header + stream} bytes, got {len(data)}")
    if zlib.crc32(body) != checksum:
        raise InputError(f"{path}: is damaged: its checksum is not that of its content")
    return body[:header], body[header:]


def read_header(path: Path, packed: bytes) -> dict[str, Any]:
    """The header with every entry checked. Raises InputError naming the one that is wrong."""
    try:
        unpacker = zlib.decompressobj()
        header = json.loads(unpacker.decompress(packed, _LONGEST_HEADER))
    except (zlib.error, ValueError, RecursionError) as error:
        raise InputError(f"{path}: header: expected JSON under zlib, got something else ({error})") from error
    if not isinstance(header, dict):
        raise InputError(f"{path}: header: expected an object, got {short(header)}")
    where = f"{path}: header"
    for key in ("fps", "frames", "name", "side", "up", "dofs", "steps", "still", "shape"):
        if key not in header:
            raise InputError(f"{where}: expected an entry {key!r}, it has none")
    frames, names = header["frames"], header["dofs"]
    if not isinstance(frames, int) or isinstance(frames, bool) or not 1 <= frames <= _MAX_FRAMES:
        raise InputError(f"{where}: frames: expected 1 to {_MAX_FRAMES}, got {short(frames)}")
    allowed: dict[str, tuple[Side, ...] | tuple[Up, ...]] = {
        "side": ("left", "right"),
        "up": ("y", "-y", "z", "-z"),
    }
    for key, choices in allowed.items():
        if header[key] not in choices:
            raise InputError(f"{where}: {key}: expected one of {', '.join(choices)}, got {short(header[key])}")
    if not isinstance(header["name"], str):
        raise InputError(f"{where}: name: expected a text, got {short(header['name'])}")
    if not isinstance(names, list) or any(name not in DOFS for name in names) or len(set(names)) < len(names):
        raise InputError(f"{where}: dofs: expected names of degrees of freedom, each once, got {short(names)}")
    header["steps"] = read_numbers(f"{where}: steps", header["steps"], (len(names),))
    if any(step <= 0 for step in header["steps"]):
        raise InputError(f"{where}: steps: expected numbers above 0, got {short(header['steps'])}")
    for key in ("still", "shape"):
        if not isinstance(header[key], dict):
            raise InputError(f"{where}: {key}: expected an object, got {short(header[key])}")
        header[key] = {name: read_number(f"{where}: {key}: {name}", value) for name, value in header[key].items()}
    for name in header["still"]:
        if name not in DOFS or name in names:
            raise InputError(f"{where}: still: expected degrees of freedom that do not move, got {short(name)}")
    header["fps"] = read_number(f"{where}: fps", header["fps"])
    return header
