"""PNG files by their chunks: checksums, and whether the compressed rows are all there; and what is in them.

Plain ones are decoded by kornia_rs, which checks all of it in a quarter of the time that zlib and OpenCV take.
"""

import struct
import zlib
from collections.abc import Iterator

import numpy as np
from jaxtyping import UInt8
from kornia_rs.io import decode_image_png_u8

from torchhand.files.pictures.formats.checked import CheckedPicture

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_KEPT = (b"IHDR", b"PLTE", b"tRNS", b"eXIf", b"IDAT", b"IEND")
"""Chunks that make the picture; profiles, texts and animations are left out, about which libpng may complain."""
_SPECIAL = (b"tRNS", b"eXIf", b"acTL")
_PLAIN = {0: "mono", 2: "rgb"}  # by the colour type
_END_OF_HEADER = 33
_LAST = b"\0\0\0\0IEND\xaeB`\x82"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by the colour type
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_PIECE = 1 << 20


def checked_png(data: bytes) -> CheckedPicture:
    """Whether a PNG file is whole, and its picture, where it is a plain one."""
    pixels = _plain(data)
    return _checked(data) if pixels is None else CheckedPicture(whole=data, pixels=pixels)


def _plain(data: bytes) -> UInt8[np.ndarray, "height width *rgb"] | None:
    """The picture of a whole file with 8 bits of grey or RGB, row by row, that is neither turned nor transparent nor
    animated."""
    if data[12:16] != b"IHDR" or len(data) < _END_OF_HEADER:
        return None
    width, height, bits, colour, _, _, is_interlaced = struct.unpack_from(">IIBBBBB", data, 16)
    chunks = list(_chunks(data))
    is_special = is_interlaced or any(kind in _SPECIAL for kind, _, _ in chunks)
    if bits != 8 or colour not in _PLAIN or is_special or data[chunks[-1][1] : chunks[-1][2]] != _LAST:
        return None
    try:
        pixels = decode_image_png_u8(data, (height, width), _PLAIN[colour])
    except Exception:  # of a class that kornia_rs does not promise
        return None
    return pixels[..., 0] if pixels.shape[-1] == 1 else pixels


def _chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Kind, place and end of every chunk up to the last one, or the first that is cut off, which ends after the
    data."""
    kind, at = b"", len(_SIGNATURE)
    while kind != b"IEND" and at < len(data):
        head = data[at : at + 8]
        kind = head[4:]
        end = at + 12 + int.from_bytes(head[:4], "big") if len(head) == 8 else len(data) + 1
        yield kind, at, end
        at = end


def _checked(data: bytes) -> CheckedPicture:
    kept, rows, last = [_SIGNATURE], list[bytes](), b""
    for kind, at, end in _chunks(data):
        if end > len(data):
            break
        last = kind
        if kind in _KEPT:
            if zlib.crc32(memoryview(data)[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
                return CheckedPicture(whole=None, problem="is a corrupt picture (a checksum of the PNG is wrong)")
            kept.append(data[at:end])
            if kind == b"IDAT":
                rows.append(data[at + 8 : end - 4])
    if last != b"IEND":
        return CheckedPicture(whole=None, problem="is a truncated PNG file")
    expected = _size_of_rows(data)
    if expected is None or _size_when_inflated(rows, expected) < expected:
        return CheckedPicture(whole=None, problem="is a corrupt picture (the rows of the PNG are damaged)")
    return CheckedPicture(whole=b"".join(kept))


def _size_of_rows(data: bytes) -> int | None:
    """Bytes of all rows with their filters' numbers, by the header."""
    if data[12:16] != b"IHDR":
        return None
    width, height, bits, colour, _, _, is_interlaced = struct.unpack_from(">IIBBBBB", data, 16)
    if colour not in _CHANNELS:
        return None
    sizes = [(width, height)]
    if is_interlaced:
        sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in _PASSES]
    return sum(h * (1 + -(-w * bits * _CHANNELS[colour] // 8)) for w, h in sizes if w > 0 and h > 0)


def _size_when_inflated(pieces: list[bytes], most: int) -> int:
    """Bytes that come out; counting ends soon after `most`, -1 where the data are no zlib stream."""
    inflate, size = zlib.decompressobj(), 0
    try:
        for piece in pieces:
            rest = piece
            while rest and size <= most:
                size += len(inflate.decompress(rest, _PIECE))
                rest = inflate.unconsumed_tail
        size += len(inflate.flush()) if size <= most else 0
    except zlib.error:
        return -1
    return size
