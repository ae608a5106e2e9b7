"""track.jsonl and track.npz: the lines of a running track, and the arrays of a track as a whole."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from torchhand.errors import InputError
from torchhand.files.disk import opened_arrays, read_lines, replacing
from torchhand.files.results.track_record import (
    ARRAY_FIELDS,
    MISSING_FIELDS,
    RESERVED_NAMES,
    TRACK_FORMAT,
    Track,
    track_of,
)

JSONL_NAME = "track.jsonl"
NPZ_NAME = "track.npz"
POSES_NAME = "poses.npz"
FIT_NAME = "keypoints_fit.npz"


def read_header(path: Path) -> tuple[dict[str, Any], int]:
    """The header of a track.jsonl and the offset of its end. Raises InputError if the file is none."""
    try:
        header, end = next(read_lines(path), ({}, 0))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if header.get("format") != TRACK_FORMAT:
        raise InputError(f"{path}: expected a track (first line with 'format': '{TRACK_FORMAT}'), got something else")
    return header, end


def keep_last_lines(path: Path) -> None:
    """Leave the header and the last line of every frame, in the frames' order; or the file as it was, and raise
    InputError."""
    start, last = 0, dict[int, tuple[int, int]]()
    for i, (record, end) in enumerate(read_lines(path)):
        last[record["frame"] if i else -1] = (start, end)
        start = end
    with replacing(path) as temporary, path.open("rb") as file, temporary.open("wb") as kept:
        for frame in sorted(last):
            start, end = last[frame]
            file.seek(start)
            kept.write(file.read(end - start))


def load_track(folder: str | Path) -> Track:
    """The track in a result folder, or that of a track.npz, poses.npz, keypoints_fit.npz or track.jsonl.

    Of a run that was stopped, the lines of track.jsonl are read where track.npz is missing or holds fewer frames.

    Raises InputError naming the file and what is wrong with it.
    """
    path = Path(folder)
    if path.suffix == ".npz":
        return _read_npz(path)
    if path.suffix == ".jsonl":
        return _read_jsonl(path)
    npz, jsonl = path / NPZ_NAME, path / JSONL_NAME
    if not npz.is_file() and not jsonl.is_file():
        for name in (POSES_NAME, FIT_NAME):
            if (path / name).is_file():
                return _read_npz(path / name)
        expected = f"{NPZ_NAME}, {JSONL_NAME}, {POSES_NAME} or {FIT_NAME}"
        raise InputError(f"{path}: expected a folder with {expected}, found none")
    if not jsonl.is_file():
        return _read_npz(npz)
    if npz.is_file():
        track = _read_npz(npz)
        if len(track) >= len({str(record.get("frame")) for record, _ in read_lines(jsonl)}) - 1:
            return track
    return _read_jsonl(jsonl)


def write_npz(track: Track, path: Path) -> None:
    """Write the arrays, or leave what was there and raise InputError."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **track.arrays())  # pyright: ignore[reportArgumentType] - the stub lacks keyword arrays


def _read_jsonl(path: Path) -> Track:
    header, _ = read_header(path)
    rows = (record for i, (record, _) in enumerate(read_lines(path)) if i > 0)
    try:
        return track_of(header, rows)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no track that can be read ({type(error).__name__}: {error})") from error


def _read_npz(path: Path) -> Track:
    complaint = "is no track that can be read"
    with opened_arrays(path, complaint=complaint) as stored:
        arrays = dict(stored)
    try:
        if path.name == FIT_NAME:
            arrays = _as_track(arrays)
        fields: dict[str, Any] = {name: arrays[name] for name in ("frame", "status", "seconds")}
        fields |= {name: arrays.get(name) if name in MISSING_FIELDS else arrays[name] for name in ARRAY_FIELDS}
        fields |= {name: str(arrays[name]) for name in ("units", "convention")}
        fields["measures"] = {name: array for name, array in arrays.items() if name not in RESERVED_NAMES}
        return Track(
            dof_names=tuple(arrays["dof_names"].tolist()),
            reason=arrays.get("reason"),
            image=arrays.get("image"),
            header=json.loads(str(arrays["header"])) if "header" in arrays else {},
            **fields,
        )
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: {complaint} ({type(error).__name__}: {error})") from error


def _as_track(fit: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What the result of `torchhand fit_keypoints` holds that a track has too; it tells no time."""
    names = ("frame", *ARRAY_FIELDS, "dof_names", "units", "convention", "header", "image")
    arrays = {name: fit[name] for name in names if name in fit}
    has_hand = np.asarray(np.isfinite(fit["pose"]).all(1))
    return arrays | {
        "status": np.where(has_hand, "tracked", "no_hand"),
        "reason": np.where(has_hand, "", fit["status"]),
        "seconds": np.full(len(has_hand), np.nan),
    }
