"""The truth that a tracked sequence is judged by: a truth.npz, and exact masks where a folder has them."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from torchhand.errors import InputError
from torchhand.evaluate.finite import median_finite
from torchhand.evaluate.positions import MIDDLE_MCP, WRIST
from torchhand.files import load_cameras, read_picture
from torchhand.files.disk import opened_arrays

SHAPES = {"keypoints3d": (21, 3), "keypoints2d": (21, 2), "flexion_deg": (5, 3)}
_PALM_M = (0.02, 0.5)  # bounds of a palm's length: no hand's, but wide enough for any in metres and no other unit


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Row i belongs to frame number i. What a sequence does not know is None."""

    source: Path
    frames: int | None
    """Number of rows; None where there are only masks."""
    keypoints3d: Float[np.ndarray, "frames 21 3"] | None = None
    """Keypoints in space, metres; camera frame, world frame for several cameras."""
    keypoints2d: Float[np.ndarray, "frames 21 2"] | None = None
    """Keypoints in the picture, px; one camera only."""
    flexion_deg: Float[np.ndarray, "frames 5 3"] | None = None
    """Degrees between successive bones of thumb, index, middle, ring, little."""
    image: tuple[str, ...] | None = None
    """Names of the pictures, where the frames are single ones."""
    side: str | None = None
    """Side of the hand: left or right."""
    sizes_px: frozenset[tuple[int, int]] = frozenset()
    """Widths and heights of the pictures, as a cameras.json beside the truth tells; empty where none does."""
    mask_files: dict[int, Path] = field(default_factory=dict)
    """Pictures by frame number; the hand is what is not 0."""


def load_truth(path: Path) -> Truth:
    """Read a folder with truth.npz and masks/ (either may be missing), or a truth file itself.

    Raises:
        InputError: nothing there, not an npz file, no known key, arrays of wrong or differing shapes or without a
            single frame that is known, or keypoints in space that are not in metres.
    """
    if not path.exists():
        raise InputError(f"{path}: expected a folder with truth.npz, or that file; there is nothing")
    file = path / "truth.npz" if path.is_dir() else path
    mask_files = numbered_pictures(file.parent / "masks")
    if not file.exists():
        if not mask_files:
            raise InputError(f"{path}: expected truth.npz or masks/ in this folder; neither is there")
        return Truth(source=path, frames=None, mask_files=mask_files)
    arrays, names, side = _known_arrays(file)
    lengths = {key: len(array) for key, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(f"{file}: expected arrays of one length, got {_listed(lengths)}")
    count = next(iter(lengths.values()))
    if names is not None and len(names) != count:
        raise InputError(f"{file}: image: expected {count} names, got {len(names)}")
    _check_content(file, arrays)
    sizes = _picture_sizes(file.parent / "cameras.json")
    return Truth(source=file, frames=count, image=names, side=side, sizes_px=sizes, mask_files=mask_files, **arrays)


def numbered_pictures(folder: Path) -> dict[int, Path]:
    """Pictures of a folder by the last number in their names; empty where the folder is missing."""
    if not folder.is_dir():
        return {}
    files = [file for file in folder.iterdir() if file.suffix.lower() in (".png", ".jpg", ".jpeg", ".bmp", ".tif")]
    return {int(digits[-1]): file for file in sorted(files) if (digits := re.findall(r"\d+", file.stem))}


def load_mask(file: Path) -> Bool[np.ndarray, "height width"]:
    """Read one mask; the hand is what is not 0.

    Raises:
        InputError: the picture cannot be read.
    """
    return read_picture(file).numpy().max(-1) > 0


def _check_content(file: Path, arrays: dict[str, np.ndarray]) -> None:
    """Raises InputError for arrays that no result can be judged by."""
    for key, array in arrays.items():
        if not np.isfinite(array).any():
            raise InputError(f"{file}: {key}: expected known numbers, got none in {len(array)} frames")
    if "keypoints3d" not in arrays:
        return
    palm_m = median_finite(np.linalg.norm(np.diff(arrays["keypoints3d"][:, [WRIST, MIDDLE_MCP]], axis=1), axis=-1))
    if palm_m <= _PALM_M[0] or palm_m >= _PALM_M[1]:  # not where it is unknown
        raise InputError(
            f"{file}: keypoints3d: expected metres, in which the middle finger's MCP is some 0.09 from the wrist,"
            f" got {palm_m:.3g}"
        )


def _picture_sizes(cameras: Path) -> frozenset[tuple[int, int]]:
    """Empty where there is no such file that can be read: nothing but a note depends on it."""
    try:
        return frozenset((camera.width, camera.height) for camera in load_cameras(cameras))
    except InputError:
        return frozenset()


def _known_arrays(file: Path) -> tuple[dict[str, np.ndarray], tuple[str, ...] | None, str | None]:
    """The arrays, and the names of the pictures and the hand's side where the file has them."""
    complaint = f"expected an npz file with {', '.join(SHAPES)}; it cannot be read as one"
    with opened_arrays(file, complaint=complaint) as stored:
        given = list(stored)
        arrays = {key: np.asarray(stored[key]) for key in SHAPES if key in given}
        names = tuple(str(name) for name in np.atleast_1d(stored["image"])) if "image" in given else None
        side = str(stored["side"]) if "side" in given else None
    if not arrays:
        raise InputError(f"{file}: expected at least one of {', '.join(SHAPES)}; got {', '.join(given) or 'no key'}")
    for key, array in arrays.items():
        if array.ndim != 3 or array.shape[1:] != SHAPES[key] or not np.issubdtype(array.dtype, np.number):
            wanted = ", ".join(str(size) for size in SHAPES[key])
            raise InputError(f"{file}: {key}: expected numbers of shape (frames, {wanted}), got {array.shape}")
    return {key: array.astype(np.float64) for key, array in arrays.items()}, names, side


def _listed(lengths: dict[str, int]) -> str:
    return ", ".join(f"{key} {length}" for key, length in lengths.items())
