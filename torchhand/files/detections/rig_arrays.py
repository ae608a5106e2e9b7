"""Keypoints of several cameras in one array file: points in the pictures (cameras, frames, 21, 2)."""

from pathlib import Path

import numpy as np

from torchhand.errors import InputError
from torchhand.files.detections.keypoint_arrays import (
    BEYOND_PICTURE,
    CONFIDENCE_NAMES,
    EITHER_NAMES,
    PICTURE_NAMES,
    SPACE_NAMES,
    detections_of_arrays,
    stored_arrays,
    without_marks,
)
from torchhand.files.detections.record import COUNT, Detections, Side, Units

_OWN_DIMENSIONS = {"std_px": 1, "cov_px": 3, "label": 0, "score": 0} | dict.fromkeys(SPACE_NAMES, 2)
"""Dimensions of arrays after those for cameras and frames."""


def read_rig_arrays(
    path: Path, *, side: Side | None = None, units: Units | None = None, is_mirrored: bool = False
) -> list[Detections] | None:
    """The keypoints of one hand before every camera; None for a file of one camera.

    Beside the points an .npz may hold what files of one camera do (confidence, std_px, cov_px, world, label, score),
    with a dimension for cameras in front; what has none is the same for all. Missing points are as in those
    (`read_keypoint_arrays`). A camera that never saw the hand has no points.

    Raises InputError naming the file and the array.
    """
    arrays = stored_arrays(path)
    usual = [name for name in (*PICTURE_NAMES, *EITHER_NAMES) if name in arrays]
    name = (usual or list(arrays))[0] if len(arrays) == 1 or usual else ""
    points = arrays.get(name, np.empty(0))
    if points.ndim != 4:
        return None
    where = f"{path}: {name}" if name else str(path)
    if points.shape[2:] != (COUNT, 2) or not points.shape[0] or not points.shape[1]:
        raise InputError(f"{where}: expected an array (cameras, frames, {COUNT}, 2), got {points.shape}")
    if not (np.issubdtype(points.dtype, np.floating) or np.issubdtype(points.dtype, np.integer)):
        raise InputError(f"{where}: expected numbers, got {points.dtype}")
    if units == "metres":
        raise InputError(f"{where}: expected points in pictures, got --units metres")
    seen = without_marks(points.astype(np.float64))
    seen[~np.isfinite(seen).all(-1)] = np.nan
    if not np.isfinite(seen).any():
        raise InputError(f"{where}: expected numbers, got no point in any picture")
    units = units or ("normalised" if np.nanmax(seen) <= BEYOND_PICTURE else "px")
    views = []
    for view, own in enumerate(seen):
        others = {key: _of_view(key, value, view, points) for key, value in arrays.items() if key != name}
        if np.isfinite(own).all(-1).any():
            views.append(
                detections_of_arrays(path, others | {name: own}, side=side, units=units, is_mirrored=is_mirrored)
            )
        else:
            views.append(_nothing(len(own), units))
    return views


def _nothing(frames: int, units: Units) -> Detections:
    """Of a camera that never saw the hand."""
    return Detections(
        picture=np.full((frames, COUNT, 2), np.nan),
        space=None,
        confidence=np.zeros((frames, COUNT)),
        frame=np.arange(frames),
        label=(None,) * frames,
        score=np.full(frames, np.nan),
        side=None,
        is_normalised=units == "normalised",
    )


def _of_view(name: str, value: np.ndarray, view: int, points: np.ndarray) -> np.ndarray:
    """What an array says of one camera."""
    own = 1 if name in CONFIDENCE_NAMES and value.ndim > 2 else _OWN_DIMENSIONS.get(name)
    has_cameras = own is not None and value.ndim == 2 + own and value.shape[:2] == points.shape[:2]
    return value[view] if has_cameras else value
