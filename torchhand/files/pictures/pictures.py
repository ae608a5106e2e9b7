"""Single pictures and folders of pictures: any depth and any number of channels in, 8-bit RGB out."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Shaped, UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files.pictures.decoding import read_raw
from torchhand.files.pictures.frame_source import ASSUMED_FPS, Frame, FrameRange, FrameSource, check_size
from torchhand.files.pictures.limits import size_problem

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".ppm")

_FULL_SCALES = tuple(float(2**bits - 1) for bits in (8, 10, 12, 14, 16))
_ROWS = 256  # that are converted at once, so that a large picture is not held in floating point


def natural_key(path: Path) -> tuple[object, ...]:
    """Sorting key that puts frame2 before frame10."""
    parts = re.split(r"(\d+)", path.name.casefold())
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts), path.name


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Names of a folder's files without their suffixes; with these where that would name two files alike."""
    stems, names = Counter(path.stem for path in paths), {path.name for path in paths}
    return [path.stem if stems[path.stem] == 1 and path.stem not in names else path.name for path in paths]


def read_picture(path: Path) -> UInt8[Tensor, "height width 3"]:
    """One picture as 8-bit RGB. Raises InputError naming the file and what is wrong with it."""
    raw, problem = read_raw(path)
    if raw is None:
        raise InputError(f"{path}: {problem}")
    return rgb8(raw, full_scale(raw))


def named_picture(picture: str | Path | Tensor | np.ndarray) -> tuple[str, UInt8[Tensor, "height width 3"]]:
    """A picture, from a file or RGB as uint8 (height, width, 3), and what to call it in a complaint. Raises InputError
    for what is none."""
    if isinstance(picture, str | Path):
        return str(picture), read_picture(Path(picture))
    if isinstance(picture, np.ndarray) and picture.dtype == np.uint8:
        picture = torch.from_numpy(picture.copy())  # row by row and writable, as torch wants it
    is_tensor = isinstance(picture, Tensor)
    if not is_tensor or picture.dtype != torch.uint8 or picture.shape[2:] != (3,) or not picture.numel():
        is_array = isinstance(picture, Tensor | np.ndarray)
        got = f"{picture.dtype} {tuple(picture.shape)}" if is_array else type(picture).__name__
        raise InputError(f"picture: expected RGB, uint8 (height, width, 3), got {got}")
    if problem := size_problem(picture.shape[1], picture.shape[0]):
        raise InputError(f"picture: {problem}")
    return "picture", picture


class PictureSource(FrameSource):
    """Pictures of one size, in the order given.

    A picture that cannot be decoded becomes a frame without image. What counts as white in pictures of more than 8 bits
    is decided by the first good picture of the folder and kept, so that brightness does not flicker (`full_scale`).
    """

    def __init__(self, name: str, paths: Sequence[Path], frames: FrameRange) -> None:
        if frames.start >= len(paths):
            raise InputError(f"{name}: start {frames.start} lies after the last picture ({len(paths) - 1})")
        self.name, self.fps = name, ASSUMED_FPS
        self.count = frames.within(len(paths))
        self._paths, self._frames = list(paths), frames
        self._used = False
        problem = ""
        for path in self._paths:
            raw, problem = read_raw(path)
            if raw is not None:
                self.height, self.width = raw.shape[:2]
                self._full_scale = full_scale(raw)
                return
        raise InputError(f"{self._paths[-1]}: {problem} (no picture of {len(paths)} could be read)")

    def __iter__(self) -> Iterator[Frame]:
        if self._used:
            raise ValueError("a source is read once; open it again")
        self._used = True
        for index in range(self._frames.first, self._frames.first + (self.count or 0)):
            path = self._paths[index]
            raw, problem = read_raw(path)
            if raw is None:
                yield Frame(index=index, time_s=index / self.fps, image=None, problem=f"{path}: {problem}")
                continue
            image = rgb8(raw, self._full_scale)
            check_size(str(path), image, width=self.width, height=self.height)
            yield Frame(index=index, time_s=index / self.fps, image=image)

    def close(self) -> None:
        pass


def full_scale(raw: Shaped[np.ndarray, "height width ..."]) -> float:
    """The value that stands for white, guessed from one picture.

    Integers: 255, or for 16-bit pictures the full scale of the smallest of 8, 10, 12, 14, 16 bits that holds the
    largest value, because 10- and 12-bit cameras store their numbers unscaled. Floating point: 1 if no value is larger,
    else by the same rule as integers.
    """
    if raw.dtype == np.uint8:
        return 255.0
    finite = raw if raw.dtype.kind in "ui" else raw[np.isfinite(raw)]
    largest = float(finite.max()) if finite.size else 0.0
    if raw.dtype.kind == "f" and largest <= 1.0:
        return 1.0
    if largest <= 0.0:
        return _FULL_SCALES[-1]
    return next((scale for scale in _FULL_SCALES if largest <= scale), largest)


def rgb8(raw: Shaped[np.ndarray, "height width ..."], white: float) -> UInt8[Tensor, "height width 3"]:
    """OpenCV's picture (grey, BGR or BGRA, any depth) as 8-bit RGB; `white` becomes 255, alpha is dropped."""
    if raw.dtype != np.uint8:
        deep, raw = raw, np.empty(raw.shape, np.uint8)
        for rows in (slice(start, start + _ROWS) for start in range(0, len(deep), _ROWS)):
            part = np.nan_to_num(deep[rows].astype(np.float32), nan=0.0, posinf=white, neginf=0.0)
            raw[rows] = np.clip(np.rint(part * np.float32(255.0 / white)), 0, 255)
    channels = 1 if raw.ndim == 2 else raw.shape[2]
    if channels in (1, 2):  # two: grey and alpha
        grey = raw if raw.ndim == 2 else raw[..., 0]
        rgb = cv2.cvtColor(np.ascontiguousarray(grey), cv2.COLOR_GRAY2RGB)
    elif raw[..., ::-1].flags.c_contiguous:  # a view of RGB
        rgb = raw[..., ::-1]
    else:
        rgb = cv2.cvtColor(raw, cv2.COLOR_BGR2RGB if channels == 3 else cv2.COLOR_BGRA2RGB)
    return torch.from_numpy(rgb)
