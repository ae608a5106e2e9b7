"""The folder of a simulated sequence: whole or not there at all, and nothing else in it."""

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files.disk import explained_errors

PictureFormat = Literal["jpg", "png"]

FRAMES_NAME, MASKS_NAME, TRUTH_NAME = "frames", "masks", "truth.npz"
CAMERAS_NAME, VIDEO_NAME, ABOUT_NAME = "cameras.json", "video.mp4", "about.json"
SEQUENCE_NAMES = (FRAMES_NAME, MASKS_NAME, TRUTH_NAME, CAMERAS_NAME, VIDEO_NAME, ABOUT_NAME)
"""What a sequence folder may hold."""
VIEW_NAME, VIEW_MASKS_NAME = "view_{}", "masks_{}"
"""Pictures and masks of each camera of a rig, in place of frames and masks."""

_OF_A_RIG = re.compile(r"(view|masks)_\d+")
_JPEG_QUALITY = 95


def check_sequence_folder(out_dir: str | Path, *, overwrite: bool = False) -> None:
    """Raise InputError where no sequence may be written: a file, or a folder with something in it.

    With `overwrite` an older sequence may be replaced, but no folder that holds anything else.
    """
    path = Path(out_dir)
    with explained_errors(path):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: expected a folder for the sequence, got a file")
        content = sorted(entry.name for entry in path.iterdir()) if path.is_dir() else []
    if content and not overwrite:
        names = ", ".join(content[:3]) + (", ..." if content[3:] else "")
        raise InputError(
            f"{path}: the output folder exists and is not empty ({names}); give another, or --overwrite to replace the"
            " sequence in it"
        )
    foreign = [name for name in content if name not in SEQUENCE_NAMES and not _OF_A_RIG.fullmatch(name)]
    if foreign:
        raise InputError(
            f"{path}: cannot be replaced: it holds {foreign[0]}, which is no part of a simulated sequence"
            f" ({', '.join(SEQUENCE_NAMES)}, view_0, masks_0, ...)"
        )


@dataclass(frozen=True, kw_only=True)
class SequenceFolder:
    """Where a sequence goes."""

    path: str | Path
    picture_format: PictureFormat = "jpg"
    overwrite: bool = False
    """Whether an older sequence there is replaced."""

    @contextlib.contextmanager
    def written(self) -> Iterator[Path]:
        """A temporary folder that takes its place when the block ends well. Raises InputError where it cannot."""
        check_sequence_folder(self.path, overwrite=self.overwrite)
        with whole_folder(Path(self.path)) as folder:
            yield folder


@contextlib.contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place when the block ends well, and is removed otherwise."""
    temporary, replaced = path.with_name(f".{path.name}.partial"), path.with_name(f".{path.name}.replaced")
    with explained_errors(path):
        try:
            shutil.rmtree(temporary, ignore_errors=True)
            temporary.mkdir(parents=True)
            yield temporary
            if path.exists():
                shutil.rmtree(replaced, ignore_errors=True)
                os.replace(path, replaced)
            os.replace(temporary, path)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        finally:
            if path.exists():
                shutil.rmtree(replaced, ignore_errors=True)
            elif replaced.exists():
                os.replace(replaced, path)


def write_picture(path: Path, picture: UInt8[Tensor, "height width 3"] | Bool[Tensor, "height width"]) -> None:
    """A colour picture, or a mask as 0 and 255."""
    pixels = picture.cpu().numpy()
    pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels.astype(np.uint8) * 255
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if path.suffix == ".jpg" else []
    _, encoded = cv2.imencode(path.suffix, pixels, options)
    path.write_bytes(encoded.tobytes())  # so that the system says why it refuses
