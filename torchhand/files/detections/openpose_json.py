"""OpenPose's keypoint files: one JSON per frame, people with 3 x 21 numbers per hand."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchhand.errors import InputError
from torchhand.files.detections.record import COUNT, Detections, HandDetection, Side, detections_of
from torchhand.files.disk import read_json, read_numbers, short
from torchhand.files.pictures import natural_key

_SIDES: tuple[Side, ...] = ("left", "right")
_PATTERN = "*_keypoints.json"


def read_openpose_folder(folder: Path, *, side: Side | None = None) -> Detections:
    """The frames of a folder of *_keypoints.json, in natural order.

    A frame's number is the last one in its file's name, or its place where not all names have a different one.
    """
    try:
        files = sorted(folder.glob(_PATTERN), key=natural_key)
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror or error})") from error
    if not files:
        raise InputError(f"{folder}: expected OpenPose's files {_PATTERN}, found none")
    numbers = [re.findall(r"\d+", file.stem) for file in files]
    named = [int(found[-1]) for found in numbers if found]
    if len(named) < len(files) or sorted(set(named)) != named:
        named = list(range(len(files)))
    return openpose_detections([(f, n, read_json(f)) for f, n in zip(files, named, strict=True)], side=side)


def openpose_detections(frames: Sequence[tuple[Path, int, Any]], *, side: Side | None = None) -> Detections:
    """Detections of (file, frame number, content). Of several people, the hand with the highest total confidence
    counts.

    Without a side, that of the higher total over all frames. Points with confidence 0 (OpenPose writes zeros) are
    missing; a confidence above 1 counts as 1.
    """
    hands = [{s: _hand(path, content, s) for s in _SIDES} for path, _, content in frames]
    if side is None:
        totals = {s: sum(0.0 if (h := hand[s]) is None else float(h[:, 2].sum()) for hand in hands) for s in _SIDES}
        if not any(totals.values()):
            raise InputError(f"{_source(frames)}: expected at least one hand, got none in {len(frames)} frames")
        side = "left" if totals["left"] > totals["right"] else "right"
    rows = []
    for (_, number, _), hand in zip(frames, hands, strict=True):
        found = hand[side]
        own = None if found is None else HandDetection(picture=found, space=None, confidence=found[:, 2], label=side)
        rows.append((number, own))
    return detections_of(_source(frames), rows, side=side)


def _source(frames: Sequence[tuple[Path, int, Any]]) -> str:
    path = frames[0][0]
    return str(path if len(frames) == 1 else path.parent)


def _hand(path: Path, content: Any, side: Side) -> np.ndarray | None:
    """(21, 3) x, y, confidence of the most certain hand of that side."""
    people = content.get("people") if isinstance(content, dict) else None
    if not isinstance(people, list):
        raise InputError(f"{path}: expected OpenPose's keypoints ('people': [...]), got {short(content)}")
    best: np.ndarray | None = None
    key = f"hand_{side}_keypoints_2d"
    for i, person in enumerate(people):
        if not isinstance(person, dict):
            raise InputError(f"{path}: people[{i}]: expected an object with {key}, got {short(person)}")
        numbers = person.get(key, [])
        if numbers == []:
            continue
        found = np.array(read_numbers(f"{path}: people[{i}].{key}", numbers, (3 * COUNT,))).reshape(COUNT, 3)
        if (found[:, 2] < 0).any():
            raise InputError(f"{path}: people[{i}].{key}: expected confidences of 0 or more, got {found[:, 2].min():g}")
        found[:, 2] = found[:, 2].clip(0, 1)
        if found[:, 2].any() and (best is None or found[:, 2].sum() > best[:, 2].sum()):
            best = found
    return best
