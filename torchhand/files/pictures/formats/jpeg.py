"""JPEG files by their markers: the declared frame, whether they end, whether what is coded in them is whole; and what
is coded.

libjpeg paints what is missing grey and only prints a warning, to the whole process's error stream. libjpeg-turbo's own
interface (through kornia_rs) makes an error of the same warnings, for its caller alone; its pixels are OpenCV's.
"""

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8
from kornia_rs.io import decode_image_jpegturbo

from torchhand.files.pictures.formats.checked import CheckedPicture

_MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")  # 0xd0 to 0xd7 stand within coded data
_END, _SCAN, _APP1 = 0xD9, 0xDA, 0xE1
_WITHOUT_LENGTH = (0x01, 0xD8)
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # the three are tables
_PLAIN_FRAMES = (0xC0, 0xC1, 0xC2)  # Huffman-coded, sequential or progressive
_MAX_SCANS = 200  # a progressive picture has some ten; thousands are made to keep a decoder busy
_MAX_PADDING = 16  # bytes that cheap encoders add before the end; damaged data leave hundreds


@dataclass(frozen=True, kw_only=True)
class JpegFrame:
    """What a JPEG's frame header declares."""

    kind: int
    """Second byte of the frame's marker."""
    bits: int
    width: int
    height: int
    components: int


def jpeg_frame(data: bytes) -> JpegFrame | None:
    """The first frame header; None where there is none before the coded data."""
    for kind, at in _markers(data):
        if kind in _FRAMES and at + 8 <= len(data):
            bits, height, width, components = (
                data[at + 2],
                int.from_bytes(data[at + 3 : at + 5], "big"),
                int.from_bytes(data[at + 5 : at + 7], "big"),
                data[at + 7],
            )
            return JpegFrame(kind=kind, bits=bits, width=width, height=height, components=components)
        if kind == _SCAN:
            break
    return None


def checked_jpeg(data: bytes) -> CheckedPicture:
    """Whether a JPEG file is whole, without padding before the end, and its picture, where it is a plain one."""
    end, scans, has_exif = None, 0, False
    for kind, at in _markers(data):
        scans += kind == _SCAN
        has_exif |= kind == _APP1 and data[at + 2 : at + 6] == b"Exif"
        if kind == _END:
            end = at
            break
    if end is None:
        return CheckedPicture(whole=None, problem="is a truncated JPEG file")
    if scans > _MAX_SCANS:
        return CheckedPicture(whole=None, problem=f"expected a JPEG of at most {_MAX_SCANS} scans, got more")
    frame = jpeg_frame(data)
    if frame is None or frame.kind not in _PLAIN_FRAMES or frame.bits != 8 or frame.components not in (1, 3):
        return CheckedPicture(whole=data)  # rare kinds, which this check cannot read
    for padding in range(_MAX_PADDING + 1):
        whole = data[: end - 2 - padding] + data[end - 2 : end]
        decoded = _decoded(whole, is_grey=has_exif)
        if decoded is not None:
            return CheckedPicture(whole=whole, pixels=None if has_exif else decoded)
    return CheckedPicture(whole=None, problem="is a corrupt picture (the coded data of the JPEG are damaged)")


def _markers(data: bytes):
    """Second bytes of all markers outside coded data, each with the place after it."""
    at = 2
    while match := _MARKER.search(data, at):
        kind, at = data[match.start() + 1], match.end()
        yield kind, at
        if kind not in _WITHOUT_LENGTH and at + 2 <= len(data):
            at += int.from_bytes(data[at : at + 2], "big")


def _decoded(data: bytes, *, is_grey: bool) -> UInt8[np.ndarray, "height width *channels"] | None:
    """None where the coded data are not whole. Grey takes half the time, and every coefficient is read there too."""
    try:
        return decode_image_jpegturbo(data, "mono" if is_grey else "rgb")
    except Exception:  # of a class that kornia_rs does not promise
        return None
