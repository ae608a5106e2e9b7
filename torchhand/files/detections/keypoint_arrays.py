"""Keypoints as numpy arrays: .npy, or .npz under one of the usual names."""

from pathlib import Path
from typing import Literal

import numpy as np

from torchhand.errors import InputError
from torchhand.files.detections.record import COUNT, Detections, Side, Units, detections_of
from torchhand.files.disk import opened_arrays

_SPACE_NAMES = (
    "keypoints3d",
    "world_landmarks",
    "hand_world_landmarks",
    "joints3d",
    "joints",
    "keypoints",
    "landmarks",
)
_PICTURE_NAMES = ("keypoints2d", "image_landmarks", "hand_landmarks", "joints2d", "keypoints", "landmarks")
_CONFIDENCE_NAMES = ("confidence", "confidences", "visibility", "scores", "score")
_BEYOND_PICTURE = 2.0  # shares of a picture may lie outside it, but not by more than its size


def read_keypoint_arrays(
    path: Path,
    *,
    side: Side | None = None,
    units: Units | None = None,
    points: Literal["auto", "space", "picture"] = "auto",
) -> Detections:
    """(frames, 21, 3) or (21, 3) in metres, or (frames, 21, 2) in px or shares of the picture; NaN for missing points.

    Without `units`, three columns are metres; two are shares where none is beyond ±2, else px. With normalised or px
    given, a third column (MediaPipe's z) is dropped. Of an .npz, the array under a usual name (keypoints3d,
    keypoints2d, world_landmarks, landmarks ...), or the only one; also confidence (frames, 21), frame and side.
    """
    arrays = _arrays(path)
    name, found = _keypoints(
        path, arrays, "picture" if points == "picture" or units in ("px", "normalised") else points
    )
    where = f"{path}: {name}" if name else str(path)
    if not (np.issubdtype(found.dtype, np.floating) or np.issubdtype(found.dtype, np.integer)):
        raise InputError(f"{where}: expected numbers, got {found.dtype}")
    shape = found.shape
    if found.ndim == 2:
        found = found[None]
    if found.ndim != 3 or found.shape[1] != COUNT or found.shape[2] not in (2, 3) or not len(found):
        raise InputError(f"{where}: expected an array (frames, {COUNT}, 2 or 3), got {shape}")
    found = found.astype(np.float64)
    if not np.isfinite(found).all(-1).any():
        raise InputError(f"{where}: expected numbers, got NaN or infinity at every point")
    if units == "metres" and found.shape[2] == 2:
        raise InputError(f"{where}: expected three columns for metres, got two")
    if units is None:
        is_share = np.nanmax(np.abs(np.where(np.isfinite(found), found, np.nan))) <= _BEYOND_PICTURE
        units = "metres" if found.shape[2] == 3 else "normalised" if is_share else "px"
    trust = _beside(path, arrays, _CONFIDENCE_NAMES, found.shape[:2], of_one_frame=shape[:1])
    if trust is not None and (trust < 0).any():
        raise InputError(f"{path}: confidence: expected 0 or more, got {np.nanmin(trust):g}")
    numbers = _beside(path, arrays, ("frame",), found.shape[:1])
    if numbers is not None and not ((np.abs(numbers) < 2.0**63) & (numbers == np.floor(numbers))).all():
        raise InputError(f"{path}: frame: expected whole numbers below 2^63, got others")
    frames = np.arange(len(found)) if numbers is None else numbers.astype(np.int64)
    rows = [(int(n), found[i], None if trust is None else trust[i].clip(0, 1)) for i, n in enumerate(frames)]
    return detections_of(where, rows, side=side or _side(arrays), units=units)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """By name; that of an .npy is empty."""
    with opened_arrays(path, complaint="expected an array file of numpy (.npy, .npz) that can be read") as stored:
        return dict(stored)


def _keypoints(path: Path, arrays: dict[str, np.ndarray], points: str) -> tuple[str, np.ndarray]:
    names = {"space": _SPACE_NAMES, "picture": _PICTURE_NAMES}.get(points, (*_SPACE_NAMES, *_PICTURE_NAMES))
    for name in ("", *names):
        if name in arrays:
            return name, arrays[name]
    if len(arrays) == 1:
        return next(iter(arrays.items()))
    expected, got = ", ".join(dict.fromkeys(names)), ", ".join(arrays) or "none"
    raise InputError(f"{path}: expected an array named {expected}, got {got}")


def _beside(
    path: Path,
    arrays: dict[str, np.ndarray],
    names: tuple[str, ...],
    shape: tuple[int, ...],
    *,
    of_one_frame: tuple[int, ...] | None = None,
) -> np.ndarray | None:
    name = next((name for name in names if name in arrays), None)
    if name is None:
        return None
    found = arrays[name]
    if found.shape == of_one_frame and shape[0] == 1:
        found = found[None]
    if found.shape != shape or not (np.issubdtype(found.dtype, np.floating) or np.issubdtype(found.dtype, np.integer)):
        raise InputError(f"{path}: {name}: expected numbers of shape {shape}, got {found.dtype} of {found.shape}")
    return found


def _side(arrays: dict[str, np.ndarray]) -> Side | None:
    side = str(arrays["side"]).casefold() if "side" in arrays and arrays["side"].ndim == 0 else ""
    return "left" if side == "left" else "right" if side == "right" else None
