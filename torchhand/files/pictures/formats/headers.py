"""The size of a picture from its first bytes, before anything is decoded."""

import re
import struct

from torchhand.files.pictures.formats.jpeg import jpeg_frame

_LONGEST_NETPBM = 4096  # bytes of comments before the numbers


def declared_size(data: bytes) -> tuple[int, int] | None:
    """Width and height that a JPEG, PNG, BMP, TIFF, WebP or netpbm file claims to have; None for anything else."""
    try:
        return _size(data)
    except (struct.error, ValueError, OverflowError):  # cut off within its header
        return None


def _size(data: bytes) -> tuple[int, int] | None:
    if data.startswith(b"\xff\xd8"):
        frame = jpeg_frame(data)
        return None if frame is None else (frame.width, frame.height)
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return struct.unpack_from(">II", data, 16)
    if data.startswith(b"BM"):
        return _bmp(data)
    if data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return _tiff(data)
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return _webp(data)
    if re.match(rb"P[1-7Ff]", data):
        return _netpbm(data)
    return None


def _bmp(data: bytes) -> tuple[int, int]:
    (header,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if header == 12 else "<ii", data, 18)
    return abs(width), abs(height)  # a height below zero: rows from above


def _tiff(data: bytes) -> tuple[int, int] | None:
    """The largest size that any of the first directory's two tags tells."""
    order, is_big = "<" if data.startswith(b"II") else ">", data[2:4] in (b"+\0", b"\0+")
    (offset,) = struct.unpack_from(order + ("Q" if is_big else "I"), data, 8 if is_big else 4)
    (entries,) = struct.unpack_from(order + ("Q" if is_big else "H"), data, offset)
    start, step = (offset + 8, 20) if is_big else (offset + 2, 12)
    kinds, found = {3: "H", 4: "I", 16: "Q"}, dict[int, int]()
    for at in range(start, min(len(data), start + step * entries), step):
        tag, kind = struct.unpack_from(order + "HH", data, at)
        if tag in (256, 257) and kind in kinds:
            (value,) = struct.unpack_from(order + kinds[kind], data, at + (12 if is_big else 8))
            found[tag] = max(found.get(tag, 0), value)
    return (found[256], found[257]) if len(found) == 2 else None


def _webp(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        sides = (int.from_bytes(data[at : at + 3], "little") + 1 for at in (24, 27))
        return next(sides), next(sides)
    return None


def _netpbm(data: bytes) -> tuple[int, int] | None:
    head = re.sub(rb"#[^\n]*", b" ", data[2:_LONGEST_NETPBM])
    if data.startswith(b"P7"):
        width, height = (re.search(rb"%s\s+(\d{1,12})\b" % name, head) for name in (b"WIDTH", b"HEIGHT"))
        return None if width is None or height is None else (int(width[1]), int(height[1]))
    numbers = re.match(rb"\s*(\d{1,12})\s+(\d{1,12})\s", head)
    return None if numbers is None else (int(numbers[1]), int(numbers[2]))
