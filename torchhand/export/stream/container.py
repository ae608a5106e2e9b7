"""The container of a pose stream: a header of which every entry is checked, then packets that each have a checksum.

b"THP2"; length and CRC-32 of the header (two unsigned 32-bit numbers, little-endian) and the header, JSON under zlib;
then packets: count of poses (one byte), length of the content and the lower half of the CRC-32 of count and content
(two bytes each, little-endian), the content. A packet of no poses ends the stream. So a stream can be read while it
grows, and damage is found where it is.
"""

import json
import struct
import zlib
from pathlib import Path
from typing import Any, NamedTuple

from torchhand.errors import InputError
from torchhand.export.clip import Up
from torchhand.files.disk import read_number, read_numbers, short
from torchhand.hand import DOFS, Side

MAGIC, VERSION = b"THP", b"2"
HELD = "held"
"""Channel beside the degrees of freedom: 1 where a pose repeats another because its own was lost."""
MAX_POSES = 255
"""Of a packet."""
_HEAD, _PACKET = struct.Struct("<II"), struct.Struct("<BHH")
_LONGEST_HEADER = 1 << 20
_LARGEST_NUMBER = 1 << 53


class Packet(NamedTuple):
    """Some poses as they are coded."""

    count: int
    content: bytes


def packed_header(header: dict[str, Any]) -> bytes:
    """The beginning of a stream."""
    packed = zlib.compress(json.dumps(header, separators=(",", ":")).encode(), 9)
    return MAGIC + VERSION + _HEAD.pack(len(packed), zlib.crc32(packed)) + packed


def _checksum(packet: Packet) -> int:
    return zlib.crc32(bytes([packet.count]) + packet.content) & 0xFFFF


def packed_packet(packet: Packet) -> bytes:
    """The bytes of a packet."""
    return _PACKET.pack(packet.count, len(packet.content), _checksum(packet)) + packet.content


END = packed_packet(Packet(0, b""))
"""The packet that ends a stream."""


class StreamBuffer:
    """Bytes of a stream as they come in: first gives its header, then its packets, each as soon as it is whole."""

    def __init__(self, where: Path) -> None:
        """where: what errors call the stream."""
        self.where = where
        self.has_ended = False
        self._data = bytearray()
        self._packets = 0

    def add(self, data: bytes) -> None:
        """Take the bytes that follow."""
        self._data += data

    def header(self) -> dict[str, Any] | None:
        """The header, once; None where it is not whole yet.

        Raises InputError for another kind or version of stream, and for a damaged header.
        """
        start = len(MAGIC) + len(VERSION)
        known = bytes(self._data[: len(MAGIC)])
        if known != MAGIC[: len(known)]:
            raise InputError(f"{self.where}: expected a pose stream that begins with {MAGIC.decode()!r}, got {known!r}")
        version = bytes(self._data[len(MAGIC) : start])
        if version not in (b"", VERSION):
            raise InputError(f"{self.where}: expected a pose stream of version {VERSION.decode()}, got {version!r}")
        if len(self._data) < start + _HEAD.size:
            return None
        length, checksum = _HEAD.unpack(self._data[start : start + _HEAD.size])
        end = start + _HEAD.size + length
        if length > _LONGEST_HEADER:
            raise InputError(f"{self.where}: header: is damaged: it has {length} bytes")
        if len(self._data) < end:
            return None
        packed = bytes(self._data[start + _HEAD.size : end])
        if zlib.crc32(packed) != checksum:
            raise InputError(f"{self.where}: header: is damaged: its checksum is not that of its content")
        del self._data[:end]
        return read_header(self.where, packed)

    def packet(self) -> Packet | None:
        """The next packet; None where it is not whole yet, or the stream has ended.

        Raises InputError for a damaged packet, and for bytes after the end.
        """
        if self.has_ended and self._data:
            raise InputError(f"{self.where}: goes on after its end by {len(self._data)} bytes")
        if self.has_ended or len(self._data) < _PACKET.size:
            return None
        count, length, checksum = _PACKET.unpack(self._data[: _PACKET.size])
        if len(self._data) < _PACKET.size + length:
            return None
        found = Packet(count, bytes(self._data[_PACKET.size : _PACKET.size + length]))
        if _checksum(found) != checksum:
            raise InputError(f"{self.where}: is damaged: packet {self._packets} has another checksum than its content")
        del self._data[: _PACKET.size + length]
        self._packets += 1
        self.has_ended = count == 0
        return self.packet() if self.has_ended else found


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
    for key in ("fps", "first", "name", "side", "up", "dofs", "steps", "still", "shape"):
        if key not in header:
            raise InputError(f"{where}: expected an entry {key!r}, it has none")
    first, names = header["first"], header["dofs"]
    if not isinstance(first, int) or isinstance(first, bool) or abs(first) > _LARGEST_NUMBER:
        raise InputError(f"{where}: first: expected the number of a frame, got {short(first)}")
    allowed: dict[str, tuple[Side, ...] | tuple[Up, ...]] = {
        "side": ("left", "right"),
        "up": ("y", "-y", "z", "-z"),
    }
    for key, choices in allowed.items():
        if header[key] not in choices:
            raise InputError(f"{where}: {key}: expected one of {', '.join(choices)}, got {short(header[key])}")
    if not isinstance(header["name"], str):
        raise InputError(f"{where}: name: expected a text, got {short(header['name'])}")
    if not isinstance(names, list) or any(name not in (*DOFS, HELD) for name in names) or len(set(names)) < len(names):
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
