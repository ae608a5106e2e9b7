"""PNG files by their chunks: checksums, and whether the compressed rows are all there."""

import struct
import zlib

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_KEPT = (b"IHDR", b"PLTE", b"tRNS", b"eXIf", b"IDAT", b"IEND")
"""Chunks that make the picture; profiles, texts and animations are left out, about which libpng may complain."""
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by the colour type
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_PIECE = 1 << 20


def whole_png(data: bytes) -> tuple[bytes | None, str]:
    """The bytes to decode; None and the reason where they are cut off or damaged."""
    kept, rows, kind, at = [_SIGNATURE], list[bytes](), b"", len(_SIGNATURE)
    while kind != b"IEND":
        if at + 12 > len(data):
            return None, "is a truncated PNG file"
        (length,) = struct.unpack_from(">I", data, at)
        kind, end = data[at + 4 : at + 8], at + 12 + length
        if end > len(data):
            return None, "is a truncated PNG file"
        if kind in _KEPT:
            if zlib.crc32(memoryview(data)[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
                return None, "is a corrupt picture (a checksum of the PNG is wrong)"
            kept.append(data[at:end])
            if kind == b"IDAT":
                rows.append(data[at + 8 : end - 4])
        at = end
    expected = _size_of_rows(data)
    if expected is None or _size_when_inflated(rows, expected) < expected:
        return None, "is a corrupt picture (the rows of the PNG are damaged)"
    return b"".join(kept), ""


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
