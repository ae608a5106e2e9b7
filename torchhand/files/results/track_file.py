"""track.jsonl, a line of JSON per frame with header.json beside it, and track.npz, the arrays of a track as a whole.

`pandas.read_json("track.jsonl", lines=True)` reads the lines as they are; `load_track` reads either.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchhand.errors import InputError
from torchhand.files.disk import check_plain_file, opened_arrays, read_json, read_lines, replacing, write_text
from torchhand.files.results.replacement import finish_replacement
from torchhand.files.results.track_record import (
    ARRAY_FIELDS,
    MISSING_FIELDS,
    OF_PICTURES,
    RESERVED_NAMES,
    TRACK_FORMAT,
    WANTED_END,
    Track,
    check_fields,
    track_of,
)

JSONL_NAME = "track.jsonl"
HEADER_NAME = "header.json"
"""What holds for all lines of a track.jsonl or poses.jsonl beside it."""
NPZ_NAME = "track.npz"
POSES_NAME = "poses.npz"
FIT_NAME = "keypoints_fit.npz"
UNFINISHED_NAME = "unfinished"
"""Sub-folder in which a run grows that is to replace an older result."""

_COMPLAINT = "is no track that can be read"
_MISTAKES = (KeyError, ValueError, TypeError, OverflowError, RecursionError)
_NPY_HEADER = 256  # bytes before the numbers of a one-dimensional array, and to spare


def write_header(folder: Path, header: Mapping[str, Any]) -> None:
    """Write what holds for all lines of a folder. Raises InputError where the disk refuses."""
    write_text(folder / HEADER_NAME, json.dumps(header, allow_nan=False, indent=1) + "\n")


def read_header(lines: Path) -> dict[str, Any]:
    """What holds for all lines of a file. Raises InputError where that is missing, or not that of a track."""
    path = lines.with_name(HEADER_NAME)
    try:
        first = next(read_lines(lines), ({}, 0))[0]
    except OSError as error:
        raise InputError(f"{lines}: cannot be read ({error.strerror or error})") from error
    if "format" in first:
        raise InputError(f"{lines}: was written by an earlier version, whose first line is a header; track it again")
    if not path.is_file():
        raise InputError(f"{lines}: expected a track, whose {HEADER_NAME} is beside it, found none")
    header = read_json(path)
    if not isinstance(header, dict) or header.get("format") != TRACK_FORMAT:
        raise InputError(f"{path}: expected the header of a track ('format': '{TRACK_FORMAT}'), got something else")
    return header


def keep_last_lines(path: Path) -> None:
    """Leave the last line of every frame, in the frames' order; or the file as it was, and raise InputError."""
    start, last = 0, dict[int, tuple[int, int]]()
    for record, end in read_lines(path):
        last[record["frame"]] = (start, end)
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
    place = path if path.is_dir() else path.parent
    finish_replacement(place, place / UNFINISHED_NAME)
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
        if len(track) >= len({str(record.get("frame")) for record, _ in read_lines(jsonl)}):
            return track
    return _read_jsonl(jsonl)


def write_npz(track: Track, path: Path, *, wanted_end: int | None = None) -> None:
    """Write the arrays, or leave what was there and raise InputError.

    wanted_end: of a run that has ended well, as `wanted_end_of` tells it.
    """
    arrays = track.arrays() | ({} if wanted_end is None else {WANTED_END: np.int64(wanted_end)})
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType] - the stub lacks keyword arrays


def wanted_end_of(npz: Path, jsonl: Path) -> tuple[int, int] | None:
    """Of a run that has ended well: the number of its last frame, and of the one after the last that was wanted (-1 for
    all). None where it has not, or where its lines are not those of its arrays."""
    try:
        with opened_arrays(npz, complaint=_COMPLAINT) as stored:
            frames, end = stored["frame"].tolist(), int(stored[WANTED_END])
    except InputError:
        return None
    lines = {record.get("frame") for record, _ in read_lines(jsonl)}
    return (max(frames), end) if frames and lines == set(frames) else None


def _read_jsonl(path: Path) -> Track:
    check_plain_file(path)
    header = read_header(path)
    rows = (record for record, _ in read_lines(path))
    try:
        return track_of(header, rows)
    except _MISTAKES as error:
        raise InputError(f"{path}: {_COMPLAINT} ({type(error).__name__}: {error})") from error


def _read_npz(path: Path) -> Track:
    with opened_arrays(path, complaint=_COMPLAINT) as stored:
        arrays = stored.chosen(name for name in RESERVED_NAMES if name == "image" or name not in OF_PICTURES)
        numbers = arrays["frame"].size if "frame" in arrays else 0
        measures = stored.small((name for name in stored if name not in RESERVED_NAMES), 8 * numbers + _NPY_HEADER)
    try:
        if path.name == FIT_NAME:
            arrays, measures = _as_track(arrays), {}
        fields: dict[str, Any] = {name: arrays[name] for name in ("frame", "status", "seconds")}
        fields |= {name: arrays.get(name) if name in MISSING_FIELDS else arrays[name] for name in ARRAY_FIELDS}
        fields |= {name: str(arrays[name]) for name in ("units", "convention")}
        fields |= {"dof_names": tuple(np.atleast_1d(arrays["dof_names"]).tolist()), "measures": measures}
        fields |= {name: arrays.get(name) for name in ("time_s", "reason", "image")}
        fields["header"] = json.loads(str(arrays["header"])) if "header" in arrays else {}
        check_fields(fields)
        fields = _in_64_bits(fields) | {"measures": _in_64_bits(measures)}
        return Track(**fields)
    except _MISTAKES as error:
        raise InputError(f"{path}: {_COMPLAINT} ({type(error).__name__}: {error})") from error


def _in_64_bits(arrays: dict[str, Any]) -> dict[str, Any]:
    """The same with numbers of any length in 64 bits, as a track has them."""
    kinds = {"f": np.float64, "i": np.int64, "u": np.int64}
    return {
        name: value.astype(kinds[value.dtype.kind])
        if isinstance(value, np.ndarray) and value.dtype.kind in kinds
        else value
        for name, value in arrays.items()
    }


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
