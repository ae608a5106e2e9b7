"""Keypoints as numpy arrays: .npy, or .npz under one of the usual names, in space, in pictures, or both."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from torchhand.errors import InputError
from torchhand.files.detections.record import (
    COUNT,
    Detections,
    HandDetection,
    Side,
    Units,
    detections_of,
    majority_side,
)
from torchhand.files.disk import opened_arrays, short

SPACE_NAMES = ("keypoints3d", "world", "world_landmarks", "hand_world_landmarks", "joints3d", "joints")
PICTURE_NAMES = ("keypoints2d", "points_px", "image_landmarks", "hand_landmarks", "joints2d")
EITHER_NAMES = ("", "keypoints", "landmarks")
_IN_PIXELS = "points_px"
CONFIDENCE_NAMES = ("confidence", "confidences", "visibility", "scores", "score")
BEYOND_PICTURE = 2.0  # shares of a picture may lie outside it, but not by more than its size
_MARKS = np.array(((0.0, 0.0), (-1.0, -1.0)))  # what other programs write in place of a missing point

_MEANT: dict[str, Side | None] = {"": None, "left": "left", "right": "right"}

Points = Literal["auto", "space", "picture"]


@dataclass(frozen=True, kw_only=True)
class _Kind:
    """Points of one kind."""

    name: str
    values: np.ndarray
    """Points: (frames, 21, 3) in space, (frames, 21, 2) in pictures"""
    units: Units
    is_single: bool
    """Whether the file holds one frame, without a dimension for frames."""


def read_keypoint_arrays(
    path: Path,
    *,
    side: Side | None = None,
    units: Units | None = None,
    points: Points = "auto",
    is_mirrored: bool = False,
) -> Detections:
    """(frames, 21, 3) or (21, 3) in metres, or (frames, 21, 2) in px or shares of the picture; NaN for missing points,
    in pictures also exactly (0, 0) or (-1, -1).

    Without `units`, three columns are metres; two are shares where none is beyond ±2, else px. With normalised or px
    given, a third column (MediaPipe's z) is dropped. Of an .npz, the arrays under usual names (keypoints3d, world,
    keypoints2d, points_px, landmarks ...), one in space and one in pictures, or the only one; also confidence
    (frames, 21), the points' standard deviations in the picture (std_px, of frames and points or of the points) or
    covariances (cov_px, the same with (2, 2) added), and for each frame its number (frame), the detector's score, the
    name of the picture (image), and MediaPipe's name of the hand (label, empty where it found none; see
    `read_detections` for what it means).
    """
    arrays = stored_arrays(path)
    return detections_of_arrays(path, arrays, side=side, units=units, points=points, is_mirrored=is_mirrored)


def detections_of_arrays(
    path: Path,
    arrays: dict[str, np.ndarray],
    *,
    side: Side | None = None,
    units: Units | None = None,
    points: Points = "auto",
    is_mirrored: bool = False,
) -> Detections:
    """What the arrays of a file hold, as `read_keypoint_arrays` has it."""
    kinds = _kinds(path, arrays, points, units)
    first, count = kinds[0], len(kinds[0].values)
    for other in kinds[1:]:
        if len(other.values) != count:
            raise InputError(
                f"{path}: {other.name}: expected {count} frames as in {first.name}, got {len(other.values)}"
            )
    if not any(np.isfinite(kind.values).all(-1).any() for kind in kinds):
        where = f"{path}: {first.name}" if first.name else str(path)
        raise InputError(f"{where}: expected numbers, got NaN, infinity or a mark of a missing point everywhere")
    by_units = {"metres" if kind.units == "metres" else "picture": kind for kind in kinds}
    space, picture = by_units.get("metres"), by_units.get("picture")
    trust = _confidences(path, arrays, count, first.is_single)
    labels, score = _labels(path, arrays, count, is_mirrored), _scores(path, arrays, count)
    hands = [
        HandDetection(
            picture=None if picture is None else picture.values[i],
            space=None if space is None else space.values[i],
            confidence=None if trust is None else trust[i].clip(0, 1),
            label=labels[i],
            score=score[i],
        )
        for i in range(count)
    ]
    found = detections_of(
        f"{path}: {first.name}" if first.name else str(path),
        list(zip(_numbers(path, arrays, count), hands, strict=True)),
        side=side or _side(arrays) or majority_side(labels),
        is_normalised=picture is not None and picture.units == "normalised",
        image=_texts(path, arrays, "image", count),
    )
    return replace(found, cov_px=_covariances(path, arrays, count))


def stored_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays by name; that of an .npy is empty."""
    with opened_arrays(path, complaint="expected an array file of numpy (.npy, .npz) that can be read") as stored:
        return dict(stored)


def without_marks(points: Float64[np.ndarray, "*rows 2"]) -> Float64[np.ndarray, "*rows 2"]:
    """Points in pictures with NaN in place of marks of missing ones, which are exactly (0, 0) or (-1, -1)."""
    is_mark = (points[..., None, :] == _MARKS).all(-1).any(-1)
    return np.where(is_mark[..., None], np.nan, points)


def _kinds(path: Path, arrays: dict[str, np.ndarray], points: Points, units: Units | None) -> list[_Kind]:
    """Kinds of the arrays: at most one kind in space and one in pictures, at least one of either."""
    in_space = points != "picture" and units not in ("px", "normalised")
    names = [*(SPACE_NAMES if in_space else ()), *(PICTURE_NAMES if points != "space" else ()), *EITHER_NAMES]
    chosen = [name for name in names if name in arrays]
    if not chosen and len(arrays) == 1:
        chosen = list(arrays)
    if not chosen:
        expected, got = ", ".join(filter(None, names)), ", ".join(arrays) or "none"
        raise InputError(f"{path}: expected an array named {expected}, got {got}")
    kinds: dict[bool, _Kind] = {}
    for name in chosen:
        is_picture = name in PICTURE_NAMES or points == "picture"
        if bool(kinds) and name in EITHER_NAMES:
            continue  # a plain name beside one that tells the kind
        kind = _kind(f"{path}: {name}" if name else str(path), name, arrays[name], units, is_picture)
        kinds.setdefault(kind.units == "metres", kind)
    return list(kinds.values())


def _kind(where: str, name: str, found: np.ndarray, units: Units | None, is_picture: bool) -> _Kind:
    if not _is_numeric(found):
        raise InputError(f"{where}: expected numbers, got {found.dtype}")
    shape, is_single = found.shape, found.ndim == 2
    if is_single:
        found = found[None]
    if found.ndim != 3 or found.shape[1] != COUNT or found.shape[2] not in (2, 3) or not len(found):
        raise InputError(f"{where}: expected an array (frames, {COUNT}, 2 or 3), got {shape}")
    if units == "metres" and found.shape[2] == 2 and not is_picture:
        raise InputError(f"{where}: expected three columns for metres, got two")
    found = found.astype(np.float64)
    if units not in ("px", "normalised") and found.shape[2] == 3 and not is_picture:
        return _Kind(name=name, values=found, units="metres", is_single=is_single)
    found = without_marks(found[..., :2])
    if name == _IN_PIXELS:
        units = "px"
    elif units not in ("px", "normalised"):
        known = np.abs(found[np.isfinite(found)])
        units = "normalised" if not len(known) or known.max() <= BEYOND_PICTURE else "px"
    return _Kind(name=name, values=found, units=units, is_single=is_single)


def _is_numeric(values: np.ndarray) -> bool:
    return np.issubdtype(values.dtype, np.floating) or np.issubdtype(values.dtype, np.integer)


def _confidences(path: Path, arrays: dict[str, np.ndarray], count: int, is_single: bool) -> np.ndarray | None:
    """(frames, 21); None where there are none."""
    names = [name for name in CONFIDENCE_NAMES if name in arrays and not _is_score(name, arrays[name], count)]
    if not names:
        return None
    name, found = names[0], arrays[names[0]]
    if is_single and found.shape == (COUNT,):
        found = found[None]
    if found.shape != (count, COUNT) or not _is_numeric(found):
        shapes = f"({count}, {COUNT}){f' or ({count},)' if name == 'score' else ''}"
        raise InputError(f"{path}: {name}: expected numbers of shape {shapes}, got {found.dtype} of {found.shape}")
    if (found < 0).any():
        raise InputError(f"{path}: confidence: expected 0 or more, got {np.nanmin(found):g}")
    return found


def _is_score(name: str, found: np.ndarray, count: int) -> bool:
    """Whether an array holds one number for each frame."""
    return name == "score" and found.shape == (count,) and _is_numeric(found)


def _scores(path: Path, arrays: dict[str, np.ndarray], count: int) -> list[float]:
    if "score" not in arrays or not _is_score("score", arrays["score"], count):
        return [float("nan")] * count
    return [float(value) for value in arrays["score"]]


def _labels(path: Path, arrays: dict[str, np.ndarray], count: int, is_mirrored: bool) -> list[Side | None]:
    """Which hand, frame by frame."""
    texts = _texts(path, arrays, "label", count)
    if texts is None:
        return [None] * count
    meant = _MEANT if is_mirrored else {"": None, "left": _MEANT["right"], "right": _MEANT["left"]}
    for text in texts:
        if text.casefold() not in meant:
            raise InputError(f"{path}: label: expected Left, Right or nothing for every frame, got {short(text)}")
    return [meant[text.casefold()] for text in texts]


def _covariances(path: Path, arrays: dict[str, np.ndarray], count: int) -> np.ndarray | None:
    """(frames, 21, 2, 2), px²; None where there are none."""
    names = [name for name in ("cov_px", "std_px") if name in arrays]
    if not names:
        return None
    if len(names) > 1:
        raise InputError(f"{path}: expected at most one of cov_px and std_px, got both")
    name, found = names[0], arrays[names[0]]
    own = (COUNT, 2, 2) if name == "cov_px" else (COUNT,)
    if found.shape not in ((count, *own), own) or not _is_numeric(found):
        expected = f"({count}, {', '.join(map(str, own))}) or that without frames"
        raise InputError(f"{path}: {name}: expected numbers of shape {expected}, got {found.dtype} of {found.shape}")
    cov = found.astype(np.float64)
    if name == "std_px":
        cov = (np.sign(cov) * cov**2)[..., None, None] * np.eye(2)  # below 0 stays below
    known = cov[np.isfinite(cov).all((-2, -1))]
    is_symmetric = np.allclose(known, np.swapaxes(known, -1, -2), rtol=1e-6, atol=0)
    if not is_symmetric or not (np.linalg.eigvalsh(known) > 0).all():
        raise InputError(f"{path}: {name}: expected numbers above 0 (covariances: positive definite), got others")
    return np.broadcast_to(cov, (count, COUNT, 2, 2)).copy()


def _texts(path: Path, arrays: dict[str, np.ndarray], name: str, count: int) -> tuple[str, ...] | None:
    if name not in arrays:
        return None
    found = arrays[name]
    if found.shape != (count,) or not np.issubdtype(found.dtype, np.str_):
        raise InputError(f"{path}: {name}: expected texts of shape ({count},), got {found.dtype} of {found.shape}")
    return tuple(str(text) for text in found)


def _numbers(path: Path, arrays: dict[str, np.ndarray], count: int) -> list[int]:
    """Numbers of the frames."""
    if "frame" not in arrays:
        return list(range(count))
    found = arrays["frame"]
    if found.shape != (count,) or not _is_numeric(found):
        raise InputError(f"{path}: frame: expected numbers of shape ({count},), got {found.dtype} of {found.shape}")
    if not ((np.abs(found) < 2.0**63) & (found == np.floor(found))).all():
        raise InputError(f"{path}: frame: expected whole numbers below 2^63, got others")
    return [int(number) for number in found]


def _side(arrays: dict[str, np.ndarray]) -> Side | None:
    side = str(arrays["side"]).casefold() if "side" in arrays and arrays["side"].ndim == 0 else ""
    return "left" if side == "left" else "right" if side == "right" else None
