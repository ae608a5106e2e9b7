"""From a file's bytes to the picture: refused before decoding where it is too large, damaged or no picture.

Safe in threads: whether a picture is good is decided from its bytes, never from what a decoder prints.
"""

import contextlib
from pathlib import Path

import cv2
import numpy as np

from torchhand.errors import InputError
from torchhand.files.disk import quiet_opencv, read_plain_file
from torchhand.files.pictures.formats import CheckedPicture, checked_jpeg, checked_png, declared_size
from torchhand.files.pictures.limits import size_problem

_LARGEST_BYTES = 1 << 30


def read_raw(path: Path) -> tuple[np.ndarray | None, str]:
    """The decoded picture (grey, BGR or BGRA, any depth) turned as its EXIF tag says, or None and the reason.

    That of a plain JPEG or PNG is a view of RGB, as its decoder gives it: `rgb8` takes it back without a copy.
    """
    try:
        data = read_plain_file(path, largest=_LARGEST_BYTES)
    except InputError as error:
        return None, str(error).removeprefix(f"{path}: ")
    if not data:
        return None, "is empty (0 bytes)"
    size = declared_size(data)
    if size is None:
        return None, "is no picture that can be decoded (corrupt or of an unknown format)"
    if problem := size_problem(*size):
        return None, problem
    is_jpeg = data.startswith(b"\xff\xd8")
    checked = CheckedPicture(whole=data)
    if is_jpeg:
        checked = checked_jpeg(data)
    elif data.startswith(b"\x89PNG"):
        checked = checked_png(data)
    if checked.whole is None:
        return None, checked.problem
    if checked.pixels is not None:
        raw = checked.pixels if checked.pixels.ndim == 2 else checked.pixels[..., ::-1]
    else:
        with quiet_opencv():
            raw = _decoded(np.frombuffer(checked.whole, np.uint8), is_jpeg=is_jpeg)
    if raw is None:
        return None, "is no picture that can be decoded (corrupt or of an unknown format)"
    if sorted(raw.shape[:2]) != sorted(size):
        return (
            None,
            f"is a corrupt picture ({size[0]}x{size[1]} px by its header, {raw.shape[1]}x{raw.shape[0]} inside)",
        )
    return raw, ""


def _decoded(encoded: np.ndarray, *, is_jpeg: bool) -> np.ndarray | None:
    if is_jpeg:
        with contextlib.suppress(cv2.error):
            rgb = cv2.imdecode(encoded, cv2.IMREAD_COLOR_RGB)
            return None if rgb is None else rgb[..., ::-1]
        return None
    # The second try is for grey floating-point TIFF, which OpenCV refuses to turn into colour.
    for flags in (cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH, cv2.IMREAD_UNCHANGED):
        try:
            raw = cv2.imdecode(encoded, flags)
        except cv2.error:
            continue
        if raw is not None:
            return raw
    return None
